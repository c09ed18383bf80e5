/* Claims about .dfield files: what is written is read back, and nothing damaged is ever read. */
#include "common/digest.h"
#include "common/field_file.h"
#include "common/field_layout.h"
#include "fields.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

enum { SIZE_X = 8, SIZE_Y = 6, SIZE_Z = 9 };
enum { KIND_PACKED = DF_FIELD_ADF + 1 }; /* bricks whose samples are packed in the file */

static char folder[] = "/tmp/df_test_field_file_XXXXXX";
static char path_a[64], path_b[64];

static void *read_whole(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    fseek(file, 0, SEEK_END);
    *size = (size_t)ftell(file);
    rewind(file);
    void *bytes = malloc(*size);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}

static void write_whole(const char *path, const void *bytes, size_t size) {
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    fclose(file);
}

static void make(df_field *field, int kind) {
    df_error err = {0};
    const uint32_t voxels[3] = {SIZE_X, SIZE_Y, SIZE_Z};
    const bool packed = kind == KIND_PACKED;
    assert_int_equal(test_field_sphere(field, packed ? DF_FIELD_BRICKS : (df_field_kind)kind, 4, voxels, 2.2, &err),
                     DF_OK);
    if (packed) assert_int_equal(test_field_quantise(field, DF_SAMPLE_U16, &err), DF_OK);
}

static bool has_section(const char *path, const char *name) {
    df_section_info sections[DF_SECTION_COUNT_MAX];
    df_error err = {0};
    uint32_t count;
    assert_int_equal(df_field_sections(path, sections, &count, &err), DF_OK);
    for (uint32_t i = 0; i < count; i++) {
        if (strcmp(sections[i].name, name) == 0) return true;
    }
    return false;
}

static void round_trip(int kind, df_read_mode mode) {
    df_field field, back;
    df_error err = {0};
    make(&field, kind);
    assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
    assert_int_equal(df_field_read(path_a, mode, &back, &err), DF_OK);
    assert_int_equal(field.checksum, back.checksum);
    assert_int_equal(df_field_write(&back, path_b, &err), DF_OK);
    size_t size_a, size_b;
    void *a = read_whole(path_a, &size_a), *b = read_whole(path_b, &size_b);
    assert_int_equal(size_a, size_b);
    assert_memory_equal(a, b, size_a);
    free(a);
    free(b);
    df_field_free(&field);
    df_field_free(&back);
}

static void dense_round_trip_is_byte_identical(void **state) {
    (void)state;
    round_trip(DF_FIELD_DENSE, DF_READ_COPY);
    round_trip(DF_FIELD_DENSE, DF_READ_MAP);
}

static void bricks_round_trip_is_byte_identical(void **state) {
    (void)state;
    round_trip(DF_FIELD_BRICKS, DF_READ_COPY);
    round_trip(DF_FIELD_BRICKS, DF_READ_MAP);
}

static void packed_bricks_round_trip_is_byte_identical(void **state) {
    (void)state;
    round_trip(KIND_PACKED, DF_READ_COPY);
    round_trip(KIND_PACKED, DF_READ_MAP);
    assert_true(has_section(path_a, "PACK") && !has_section(path_a, "SAMP"));
}

/* The samples that the file holds once are those of all bricks, as before they were written. */
static void packed_bricks_come_back_as_they_were(void **state) {
    (void)state;
    for (int mode = DF_READ_COPY; mode <= DF_READ_MAP; mode++) {
        df_field field, back;
        df_error err = {0};
        make(&field, KIND_PACKED);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        assert_int_equal(df_field_read(path_a, (df_read_mode)mode, &back, &err), DF_OK);
        assert_int_equal(back.sample_count, field.sample_count);
        assert_memory_equal(back.samples, field.samples, field.sample_count * sizeof(uint16_t));
        df_field_free(&field);
        df_field_free(&back);
    }
}

/* Bricks that hold two values of a sample that they share, and no file is left behind. */
static void torn_bricks_are_not_written(void **state) {
    (void)state;
    df_field field;
    df_error err = {0};
    make(&field, KIND_PACKED);
    unlink(path_a);
    /* on a face, neither the least nor the largest of its brick */
    ((uint16_t *)field.samples)[4 + 5 * (2 + 5 * 2)] ^= 1;
    assert_int_equal(df_field_write(&field, path_a, &err), DF_ERROR_INPUT);
    assert_non_null(strstr(err.text, path_a));
    assert_int_equal(access(path_a, F_OK), -1);
    df_field_free(&field);
}

/* Steps whose multiples would not be normal floats, or finite. */
static void steps_beyond_floats_are_refused(void **state) {
    (void)state;
    static const int exponents[] = {-127, 101};
    for (int i = 0; i < 2; i++) {
        df_field field, back;
        df_error err = {0};
        char step[16];
        make(&field, DF_FIELD_DENSE);
        assert_int_equal(test_field_quantise(&field, DF_SAMPLE_U16, &err), DF_OK);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        assert_int_equal(df_field_read(path_a, DF_READ_COPY, &back, &err), DF_OK);
        df_field_free(&back);
        field.step_exponent = exponents[i];
        snprintf(step, sizeof step, "2^%d", exponents[i]);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        assert_int_equal(df_field_read(path_a, DF_READ_COPY, &back, &err), DF_ERROR_FORMAT);
        assert_non_null(strstr(err.text, step));
        df_field_free(&field);
    }
}

static void adf_round_trip_is_byte_identical(void **state) {
    (void)state;
    round_trip(DF_FIELD_ADF, DF_READ_COPY);
    round_trip(DF_FIELD_ADF, DF_READ_MAP);
}

static void refuses(const void *bytes, size_t size, const char *what, size_t at) {
    df_field field;
    df_error err = {0};
    write_whole(path_b, bytes, size);
    df_status status = df_field_read(path_b, DF_READ_COPY, &field, &err);
    if (status == DF_OK) fail_msg("%s at %zu was not noticed", what, at);
    assert_true(strlen(err.text) > strlen(path_b));
    assert_null(field.samples);
}

static void every_truncation_is_refused(void **state) {
    (void)state;
    for (int kind = DF_FIELD_DENSE; kind <= KIND_PACKED; kind++) {
        df_field field;
        df_error err = {0};
        size_t size;
        make(&field, kind);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        uint8_t *bytes = read_whole(path_a, &size);
        for (size_t length = 0; length < size; length++) refuses(bytes, length, "truncation", length);
        uint8_t *longer = calloc(1, size + 64);
        memcpy(longer, bytes, size);
        for (size_t more = 1; more <= 64; more++) refuses(longer, size + more, "extension", more);
        free(longer);
        free(bytes);
        df_field_free(&field);
    }
}

static void every_bit_flip_is_refused(void **state) {
    (void)state;
    for (int kind = DF_FIELD_DENSE; kind <= KIND_PACKED; kind++) {
        df_field field;
        df_error err = {0};
        size_t size;
        make(&field, kind);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        uint8_t *bytes = read_whole(path_a, &size);
        int fd = open(path_a, O_RDWR);
        for (size_t bit = 0; bit < size * 8; bit++) {
            uint8_t flipped = (uint8_t)(bytes[bit / 8] ^ 1u << bit % 8);
            assert_int_equal(pwrite(fd, &flipped, 1, (off_t)(bit / 8)), 1);
            df_field back;
            df_status status = df_field_read(path_a, bit % 2 ? DF_READ_COPY : DF_READ_MAP, &back, &err);
            if (status == DF_OK) fail_msg("flip of bit %zu was not noticed", bit);
            assert_int_equal(pwrite(fd, &bytes[bit / 8], 1, (off_t)(bit / 8)), 1);
        }
        close(fd);
        free(bytes);
        df_field back;
        assert_int_equal(df_field_read(path_a, DF_READ_COPY, &back, &err), DF_OK);
        df_field_free(&back);
        df_field_free(&field);
    }
}

/* Checksums that hold for what the bytes have become. The body is shorter than a block of checksums. */
static void sign_again(uint8_t *bytes) {
    df_file_header *header = (df_file_header *)bytes;
    df_file_section *sections = (df_file_section *)(header + 1), *sums = &sections[header->section_count - 1];
    const uint64_t table_size = header->section_count * sizeof *sections,
                   body = df_file_align(sizeof *header + table_size);
    const uint32_t crc = df_crc32c(0, bytes + body, sums->offset - body);
    memcpy(bytes + sums->offset, &crc, sizeof crc);
    sums->crc = df_crc32c(0, &crc, sizeof crc);
    header->table_crc = df_crc32c(0, sections, table_size);
    header->header_crc = df_crc32c(0, header, sizeof *header - sizeof header->header_crc);
}

/* Where a lie stands: in the header, in the table's entry of a section, or in the section. */
typedef enum lie_place { IN_HEADER, IN_ENTRY, IN_SECTION } lie_place;

static uint8_t *find_place(uint8_t *bytes, lie_place place, const char *tag) {
    df_file_header *header = (df_file_header *)bytes;
    if (place == IN_HEADER) return bytes;
    for (df_file_section *s = (df_file_section *)(header + 1);; s++) {
        assert_true(s < (df_file_section *)(header + 1) + header->section_count);
        if (memcmp(&s->tag, tag, 4) == 0) return place == IN_ENTRY ? (uint8_t *)s : bytes + s->offset;
    }
}

#define HEADER(member) IN_HEADER, "", offsetof(df_file_header, member)
#define ENTRY(tag, member) IN_ENTRY, tag, offsetof(df_file_section, member)

static void lies_under_right_checksums_are_refused_by_name(void **state) {
    (void)state;
    enum { DENSE = DF_FIELD_DENSE, BRICKS = DF_FIELD_BRICKS, ADF = DF_FIELD_ADF };
    static const struct {
        int kind;
        lie_place place;
        const char *tag;
        size_t offset;
        uint32_t value;
        const char *words;
    } lies[] = {
        {DENSE, HEADER(reserved) + 92, 1, "reserved bytes of the header"},
        {DENSE, HEADER(kind), 0, "kind 0 is not known"},
        {DENSE, HEADER(kind), ADF + 1, "is not known to this program"},
        {DENSE, HEADER(sample_type), 0, "sample type 0 is not known"},
        {DENSE, HEADER(sample_type), DF_SAMPLE_U8 + 1, "is not known"},
        {DENSE, HEADER(verdict), DF_VERDICT_UNCERTAIN + 1, "verdict 4 is not known"},
        {DENSE, HEADER(error_max) + 4, 0x7ff80000, "the stored error is not a number"},
        {DENSE, HEADER(error_rms) + 4, 0xfff80000, "the stored error is not a number"},
        {DENSE, HEADER(brick_size), 8, "do not fit a dense field"},
        {DENSE, HEADER(block_count), 1, "do not fit a dense field"},
        {DENSE, HEADER(level_count), 1, "do not fit a dense field"},
        {DENSE, HEADER(step_exponent), 1, "do not fit a dense field"},
        {DENSE, HEADER(voxel_count[1]), 0, "0 voxels along axis 1"},
        {DENSE, HEADER(voxel_count[2]), 65537, "65537 voxels along axis 2"},
        {DENSE, HEADER(voxel_count[0]), SIZE_X + 1, "section SAMP has"},
        {DENSE, HEADER(voxel_size[1]) + 4, 0x80000000, "along axis 1 is not usable"},
        {DENSE, HEADER(origin[2]) + 4, 0x7ff00000, "along axis 2 is not usable"},
        {DENSE, HEADER(value_range[0]), 0, "but the header says"},
        {DENSE, HEADER(sample_count), 1, "but the header says"},
        {DENSE, ENTRY("SAMP", flags), 2, "is out of place"},
        {DENSE, ENTRY("SAMP", reserved), 1, "is out of place"},
        {DENSE, ENTRY("SAMP", crc), 1, "is out of place"},
        {DENSE, ENTRY("SAMP", tag), DF_SECTION_TAG('S', 'A', 'M', 'E'), "(SAME) is not known to this program"},
        {DENSE, ENTRY("SAMP", tag), DF_SECTION_CELLS, "section SAMP is missing"},
        {DENSE, ENTRY("PROV", tag), DF_SECTION_CELLS, "section PROV is missing"},
        {DENSE, ENTRY("PROV", tag), DF_SECTION_SAMPLES, "have the same name"},
        {DENSE, IN_SECTION, "PROV", 0, '[', "the provenance is not a JSON object"},
        {DENSE, IN_SECTION, "SAMP", 40, 0x7fc00000, "samples that are not finite"},
        {BRICKS, HEADER(brick_size), 5, "brick size 5 (4 and 8 are possible)"},
        {BRICKS, HEADER(brick_size), 8, "section CELL has"},
        {BRICKS, HEADER(block_count), 0xffffffff, "section SAMP has"},
        {BRICKS, IN_SECTION, "CELL", 0, 0x7fffffff, "names brick"},
        {BRICKS, IN_SECTION, "RANG", 0, 0, "section RANG does not fit the samples"},
        {BRICKS, IN_SECTION, "MASK", 0, 0x12345678, "section MASK does not fit the samples"},
        {BRICKS, IN_SECTION, "SAMP", 40, 0xff800000, "samples that are not finite"},
        {KIND_PACKED, IN_SECTION, "STEP", 0, 0x65656565, "has a step of 2^101"},
        {KIND_PACKED, ENTRY("PACK", tag), DF_SECTION_SAMPLES, "section PACK is missing"},
        {ADF, HEADER(exact_count), 1, "octree families are exact"},
        {ADF, HEADER(level_count), 17, "an octree of 17 levels"},
        {ADF, HEADER(level_count), 3, "an octree of 3 levels for 9 voxels"},
        {ADF, IN_SECTION, "SAMP", 40, 0x7f800000, "not finite"},
    };
    for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
        df_field field, back;
        df_error err = {0};
        size_t size;
        make(&field, lies[i].kind);
        assert_int_equal(df_field_write(&field, path_a, &err), DF_OK);
        uint8_t *bytes = read_whole(path_a, &size);
        sign_again(bytes);
        write_whole(path_b, bytes, size);
        assert_int_equal(df_field_read(path_b, DF_READ_COPY, &back, &err), DF_OK);
        df_field_free(&back);
        memcpy(find_place(bytes, lies[i].place, lies[i].tag) + lies[i].offset, &lies[i].value, sizeof lies[i].value);
        sign_again(bytes);
        refuses(bytes, size, lies[i].words, lies[i].offset);
        df_field_read(path_b, DF_READ_COPY, &back, &err);
        if (!strstr(err.text, lies[i].words)) fail_msg("'%s' instead of '%s'", err.text, lies[i].words);
        free(bytes);
        df_field_free(&field);
    }
}

static void samples_and_masks_agree_between_dense_and_bricks(void **state) {
    (void)state;
    df_field dense, bricks;
    make(&dense, DF_FIELD_DENSE);
    make(&bricks, DF_FIELD_BRICKS);
    assert_int_equal(df_field_surface_voxel_count(&dense), df_field_surface_voxel_count(&bricks));
    for (uint32_t z = 0; z < SIZE_Z; z++) {
        for (uint32_t y = 0; y < SIZE_Y; y++) {
            for (uint32_t x = 0; x < SIZE_X; x++) {
                float a[8], b[8];
                uint32_t voxel[3] = {x, y, z};
                df_field_corners(&dense, voxel, a);
                if (df_field_corners(&bricks, voxel, b)) assert_memory_equal(a, b, sizeof a);
                else assert_false(df_corners_straddle(a, 0));
                for (int c = 0; c < 8; c++) assert_int_equal(a[c] < 0, b[c] < 0);
            }
        }
    }
    df_field_free(&dense);
    df_field_free(&bricks);
}

static void full_octree_has_the_voxels_of_the_dense_field(void **state) {
    (void)state;
    df_field dense, adf;
    make(&dense, DF_FIELD_DENSE);
    make(&adf, DF_FIELD_ADF);
    assert_int_equal(df_field_surface_voxel_count(&dense), df_field_surface_voxel_count(&adf));
    for (uint32_t i = 0; i < SIZE_X * SIZE_Y * SIZE_Z; i++) {
        uint32_t voxel[3] = {i % SIZE_X, i / SIZE_X % SIZE_Y, i / (SIZE_X * SIZE_Y)};
        double middle[3] = {voxel[0] + 0.5, voxel[1] + 0.5, voxel[2] + 0.5};
        float a[8], b[8];
        df_adf_cell cell;
        df_field_corners(&dense, voxel, a);
        df_adf_find(&adf, middle, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(&adf, cell.family, cell.child, b);
        assert_int_equal(cell.state == DF_CHILD_SURFACE, df_corners_straddle(a, 0));
        if (cell.state != DF_CHILD_SURFACE) continue;
        assert_int_equal(cell.side, 1);
        assert_memory_equal(cell.corner, voxel, sizeof voxel);
        assert_memory_equal(a, b, sizeof a);
    }
    df_field_free(&dense);
    df_field_free(&adf);
}

static void an_octree_with_a_family_too_many_or_too_few_is_refused(void **state) {
    (void)state;
    df_field field;
    df_error err = {0};
    make(&field, DF_FIELD_ADF);
    df_family *families = (df_family *)field.families;
    for (uint32_t f = 0; f < field.family_count; f++) {
        for (int c = 0; c < 8; c++) {
            uint32_t states = families[f].states;
            families[f].states ^= df_family_state(&families[f], (uint32_t)c) == DF_CHILD_FAMILY ? 1u << 2 * c : 0;
            families[f].states |= states == families[f].states ? 3u << 2 * c : 0;
            if (df_field_finish(&field, "damaged", &err) == DF_OK) fail_msg("family %u child %d", f, c);
            families[f].states = states;
        }
    }
    field.family_count--;
    assert_int_equal(df_field_finish(&field, "damaged", &err), DF_ERROR_FORMAT);
    field.family_count++;
    assert_int_equal(df_field_finish(&field, "whole", &err), DF_OK);
    df_field_free(&field);
}

static void missing_and_special_files_are_refused(void **state) {
    (void)state;
    df_field field;
    df_error err = {0};
    assert_int_equal(df_field_read("/nowhere/x.dfield", DF_READ_COPY, &field, &err), DF_ERROR_IO);
    assert_int_equal(df_field_read(folder, DF_READ_COPY, &field, &err), DF_ERROR_IO);
    assert_int_equal(df_field_read("/dev/null", DF_READ_COPY, &field, &err), DF_ERROR_IO);
    refuses("", 0, "nothing", 0);
    refuses("plain text, no field", 20, "text", 0);
}

static int set_up(void **state) {
    (void)state;
    if (!mkdtemp(folder)) return 1;
    snprintf(path_a, sizeof path_a, "%s/a.dfield", folder);
    snprintf(path_b, sizeof path_b, "%s/b.dfield", folder);
    return 0;
}

static int tear_down(void **state) {
    (void)state;
    unlink(path_a);
    unlink(path_b);
    return rmdir(folder); /* fails when a temporary was left behind */
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(dense_round_trip_is_byte_identical),
        cmocka_unit_test(bricks_round_trip_is_byte_identical),
        cmocka_unit_test(packed_bricks_round_trip_is_byte_identical),
        cmocka_unit_test(packed_bricks_come_back_as_they_were),
        cmocka_unit_test(torn_bricks_are_not_written),
        cmocka_unit_test(steps_beyond_floats_are_refused),
        cmocka_unit_test(adf_round_trip_is_byte_identical),
        cmocka_unit_test(full_octree_has_the_voxels_of_the_dense_field),
        cmocka_unit_test(an_octree_with_a_family_too_many_or_too_few_is_refused),
        cmocka_unit_test(every_truncation_is_refused),
        cmocka_unit_test(every_bit_flip_is_refused),
        cmocka_unit_test(lies_under_right_checksums_are_refused_by_name),
        cmocka_unit_test(samples_and_masks_agree_between_dense_and_bricks),
        cmocka_unit_test(missing_and_special_files_are_refused),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
