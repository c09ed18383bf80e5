#include "common/brick_pack.h"
#include "common/digest.h"
#include "common/field_file.h"
#include "common/field_layout.h"
#include "common/interrupt.h"
#include "common/memory.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* A file that is being read. */
typedef struct source {
    const char *path;
    int fd;
    uint64_t size;
    df_file_header header;
    df_file_section sections[DF_SECTION_COUNT_MAX];
    const uint8_t *bytes; /* the whole file */
} source;

static df_status read_at(const source *file, void *out, uint64_t size, uint64_t offset, df_error *err) {
    uint8_t *bytes = out;
    while (size > 0) {
        ssize_t got = pread(file->fd, bytes, size, (off_t)offset);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return df_fail(err, DF_ERROR_IO, "%s: cannot read: %s", file->path, strerror(errno));
        if (got == 0) return df_fail(err, DF_ERROR_IO, "%s: the file became shorter while it was read", file->path);
        bytes += got;
        offset += (uint64_t)got;
        size -= (uint64_t)got;
    }
    return DF_OK;
}

static df_status open_source(source *file, const char *path, df_error *err) {
    struct stat info;
    *file = (source){.path = path, .fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK)};
    if (file->fd < 0) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    if (fstat(file->fd, &info) != 0) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    if (S_ISDIR(info.st_mode)) return df_fail(err, DF_ERROR_IO, "%s: is a folder", path);
    if (!S_ISREG(info.st_mode)) return df_fail(err, DF_ERROR_IO, "%s: is not a regular file", path);
    file->size = (uint64_t)info.st_size;
    if (file->size == 0) return df_fail(err, DF_ERROR_FORMAT, "%s: the file is empty", path);
    return DF_OK;
}

/* ---- header and section table ---- */

static bool all_zero(const uint8_t *bytes, uint64_t size) {
    uint8_t any = 0;
    for (uint64_t i = 0; i < size; i++) any |= bytes[i];
    return any == 0;
}

static df_status check_identity(const source *file, df_error *err) {
    const df_file_header *header = &file->header;
    if (memcmp(header->magic, DF_FILE_MAGIC, sizeof header->magic) != 0) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: not a .dfield file", file->path);
    }
    if (header->endian_tag != DF_FILE_ENDIAN_TAG) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the file is damaged or was written in another byte order",
                       file->path);
    }
    if (header->version != DF_FILE_VERSION) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: format version %" PRIu32 " (this program reads version %u)",
                       file->path, header->version, DF_FILE_VERSION);
    }
    if (df_crc32c(0, header, sizeof *header - sizeof header->header_crc) != header->header_crc) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the header is damaged (checksum)", file->path);
    }
    if (!all_zero(header->reserved, sizeof header->reserved)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: reserved bytes of the header are in use", file->path);
    }
    if (header->file_size != file->size) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu64 " bytes, but the header says %" PRIu64 ": %s", file->path,
                       file->size, header->file_size,
                       file->size < header->file_size ? "the file is truncated" : "there is more after its end");
    }
    if (header->section_count < 1 || header->section_count > DF_SECTION_COUNT_MAX) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu32 " sections (1 to %d are possible)", file->path,
                       header->section_count, DF_SECTION_COUNT_MAX);
    }
    return DF_OK;
}

static df_status check_table(const source *file, df_error *err) {
    const df_file_header *header = &file->header;
    uint64_t table_size = header->section_count * sizeof(df_file_section), end = sizeof *header + table_size;
    if (df_crc32c(0, file->sections, table_size) != header->table_crc) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the section table is damaged (checksum)", file->path);
    }
    for (uint32_t i = 0; i < header->section_count; i++) {
        const df_file_section *section = &file->sections[i];
        bool last = i + 1 == header->section_count;
        if (section->offset != df_file_align(end) || section->offset > file->size ||
            section->size > file->size - section->offset || (last && section->offset + section->size != file->size) ||
            section->reserved || (section->flags & ~DF_SECTION_OPTIONAL) ||
            (section->tag == DF_SECTION_CHECKSUMS) != last || (section->crc && !last)) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: section %" PRIu32 " at %" PRIu64 " with %" PRIu64 " bytes is out of place", file->path,
                           i, section->offset, section->size);
        }
        for (uint32_t j = 0; j < i; j++) {
            if (file->sections[j].tag != section->tag) continue;
            return df_fail(err, DF_ERROR_FORMAT, "%s: sections %" PRIu32 " and %" PRIu32 " have the same name",
                           file->path, j, i);
        }
        end = section->offset + section->size;
    }
    return DF_OK;
}

static df_status read_table(source *file, df_error *err) {
    if (file->size < sizeof file->header) {
        char magic[8] = {0};
        df_status status = read_at(file, magic, file->size < sizeof magic ? file->size : sizeof magic, 0, err);
        if (status != DF_OK) return status;
        if (memcmp(magic, DF_FILE_MAGIC, sizeof magic) != 0) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: not a .dfield file", file->path);
        }
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu64 " bytes: the file is truncated", file->path, file->size);
    }
    df_status status = read_at(file, &file->header, sizeof file->header, 0, err);
    if (status == DF_OK) status = check_identity(file, err);
    if (status != DF_OK) return status;
    uint64_t table_size = file->header.section_count * sizeof(df_file_section);
    if (file->size < sizeof file->header + table_size) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the section table is truncated", file->path);
    }
    status = read_at(file, file->sections, table_size, sizeof file->header, err);
    return status == DF_OK ? check_table(file, err) : status;
}

/* ---- the body ---- */

static const df_file_section *find_section(const source *file, uint32_t tag) {
    for (uint32_t i = 0; i < file->header.section_count; i++) {
        if (file->sections[i].tag == tag) return &file->sections[i];
    }
    return NULL;
}

static df_status check_sections_known(const source *file, df_error *err) {
    static const uint32_t known[] = {DF_SECTION_CELLS,  DF_SECTION_RANGES,     DF_SECTION_MASKS,
                                     DF_SECTION_STEPS,  DF_SECTION_FAMILIES,   DF_SECTION_SAMPLES,
                                     DF_SECTION_PACKED, DF_SECTION_PROVENANCE, DF_SECTION_CHECKSUMS};
    for (uint32_t i = 0; i < file->header.section_count; i++) {
        bool found = (file->sections[i].flags & DF_SECTION_OPTIONAL) != 0;
        for (size_t k = 0; k < sizeof known / sizeof known[0]; k++) found = found || file->sections[i].tag == known[k];
        if (!found) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: section %" PRIu32 " (%.4s) is not known to this program",
                           file->path, i, (const char *)&file->sections[i].tag);
        }
    }
    return DF_OK;
}

/* Fills file->bytes by reading or mapping; the field owns the memory from then on. */
static df_status load_bytes(source *file, df_read_mode mode, df_field *field, df_error *err) {
    if (mode == DF_READ_MAP) {
        df_interrupt_guard_mapping(file->path);
        void *mapping = mmap(NULL, file->size, PROT_READ, MAP_PRIVATE, file->fd, 0);
        if (mapping == MAP_FAILED) return df_fail(err, DF_ERROR_IO, "%s: cannot map: %s", file->path, strerror(errno));
        field->mapping = mapping;
        field->mapping_size = file->size;
        file->bytes = mapping;
        return DF_OK;
    }
    uint8_t *bytes;
    df_status status = df_alloc_raw((void **)&bytes, file->size, 1, file->path, err);
    if (status != DF_OK) return status;
    df_field_own(field, bytes);
    file->bytes = bytes;
    return DF_OK;
}

/* Releases what load_bytes took, once nothing of the field lies in it. */
static void drop_bytes(source *file, df_field *field) {
    if (field->mapping) {
        munmap(field->mapping, field->mapping_size);
        field->mapping = NULL;
        field->mapping_size = 0;
    } else {
        assert(field->blocks[0] == file->bytes);
        free(field->blocks[0]);
        field->blocks[0] = field->blocks[--field->block_count];
    }
    file->bytes = NULL;
}

/* Verifies the blocks of the body against CRCS, reading them first where the file is not mapped. */
static df_status verify_body(const source *file, bool mapped, df_error *err) {
    const df_file_section *crcs = &file->sections[file->header.section_count - 1];
    uint64_t begin = df_file_align(sizeof file->header + file->header.section_count * sizeof(df_file_section));
    uint64_t size = crcs->offset - begin, block_count = (size + DF_FILE_CRC_BLOCK - 1) / DF_FILE_CRC_BLOCK;
    uint8_t *bytes = (uint8_t *)file->bytes;
    if (crcs->size != block_count * sizeof(uint32_t)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu64 " bytes of checksums for %" PRIu64 " blocks", file->path,
                       crcs->size, block_count);
    }
    if (!mapped) {
        memcpy(bytes, &file->header, sizeof file->header);
        memcpy(bytes + sizeof file->header, file->sections, file->header.section_count * sizeof(df_file_section));
        uint64_t table_end = sizeof file->header + file->header.section_count * sizeof(df_file_section);
        df_status status = read_at(file, bytes + table_end, begin - table_end, table_end, err);
        if (status == DF_OK) status = read_at(file, bytes + crcs->offset, crcs->size, crcs->offset, err);
        if (status != DF_OK) return status;
    }
    const uint32_t *expected = (const uint32_t *)(file->bytes + crcs->offset);
    if (df_crc32c(0, expected, crcs->size) != crcs->crc) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the checksums are damaged", file->path);
    }
    uint64_t damaged = UINT64_MAX;
    df_status status = DF_OK;
#pragma omp parallel for schedule(dynamic) reduction(min : damaged) if (block_count > 2)
    for (uint64_t block = 0; block < block_count; block++) {
        uint64_t offset = begin + block * DF_FILE_CRC_BLOCK;
        uint64_t part = crcs->offset - offset < DF_FILE_CRC_BLOCK ? crcs->offset - offset : DF_FILE_CRC_BLOCK;
        if (!mapped) {
            df_error block_error = {0};
            df_status block_status = read_at(file, bytes + offset, part, offset, &block_error);
            if (block_status != DF_OK) {
#pragma omp critical(df_read_block)
                {
                    status = block_status;
                    if (err) *err = block_error;
                }
                continue;
            }
        }
        if (block < damaged && df_crc32c(0, file->bytes + offset, part) != expected[block]) damaged = block;
    }
    if (status != DF_OK) return status;
    if (damaged != UINT64_MAX) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: damaged within %u bytes from %" PRIu64 " on (checksum)", file->path,
                       DF_FILE_CRC_BLOCK, begin + damaged * DF_FILE_CRC_BLOCK);
    }
    return DF_OK;
}

static df_status verify_padding(const source *file, df_error *err) {
    uint64_t end = sizeof file->header + file->header.section_count * sizeof(df_file_section);
    for (uint32_t i = 0; i < file->header.section_count; i++) {
        if (!all_zero(file->bytes + end, file->sections[i].offset - end)) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: padding at %" PRIu64 " is not zero", file->path, end);
        }
        end = file->sections[i].offset + file->sections[i].size;
    }
    return DF_OK;
}

/* The section `tag`, which must exist with exactly count * size bytes; *out points into the file. */
static df_status take_section(const source *file, uint32_t tag, uint64_t count, uint64_t size, const void **out,
                              df_error *err) {
    const df_file_section *section = find_section(file, tag);
    uint64_t bytes;
    if (!section) return df_fail(err, DF_ERROR_FORMAT, "%s: section %.4s is missing", file->path, (const char *)&tag);
    if (__builtin_mul_overflow(count, size, &bytes) || section->size != bytes) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: section %.4s has %" PRIu64 " bytes, expected %" PRIu64 " x %" PRIu64,
                       file->path, (const char *)&tag, section->size, count, size);
    }
    *out = file->bytes + section->offset;
    return DF_OK;
}

/* A section copied to memory of the field's own, with a zero byte after it. */
static df_status copy_section(const source *file, df_field *field, uint32_t tag, uint64_t count, uint64_t size,
                              const void **out, df_error *err) {
    const void *data = NULL;
    uint8_t *copy = NULL;
    df_status status = take_section(file, tag, count, size, &data, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&copy, count * size + 1, 1, file->path, err);
    if (status != DF_OK) return status;
    df_field_own(field, copy);
    memcpy(copy, data, count * size);
    copy[count * size] = 0;
    *out = copy;
    return DF_OK;
}

static bool exponent_is_usable(int exponent) { return exponent >= -126 && exponent <= 100; }

static df_status fill_from_header(const source *file, df_field *field, df_error *err) {
    const df_file_header *header = &file->header;
    if (header->kind < DF_FIELD_DENSE || header->kind > DF_FIELD_ADF) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: kind %" PRIu32 " is not known to this program", file->path,
                       header->kind);
    }
    if (header->sample_type < DF_SAMPLE_F32 || header->sample_type > DF_SAMPLE_U8) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: sample type %" PRIu32 " is not known", file->path,
                       header->sample_type);
    }
    if (header->verdict > DF_VERDICT_UNCERTAIN) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: verdict %" PRIu32 " is not known", file->path, header->verdict);
    }
    if (isnan(header->error_max) || isnan(header->error_rms)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the stored error is not a number", file->path);
    }
    bool dense = header->kind == DF_FIELD_DENSE;
    bool dense_step = dense && header->sample_type != DF_SAMPLE_F32;
    if ((header->kind != DF_FIELD_BRICKS && header->brick_size) ||
        (header->kind != DF_FIELD_ADF && (header->level_count || header->exact_count)) ||
        (dense && header->block_count) || (!dense_step && header->step_exponent) ||
        !exponent_is_usable(header->step_exponent)) {
        return df_fail(err, DF_ERROR_FORMAT,
                       "%s: brick size %" PRIu32 ", %" PRIu32 " blocks, %" PRIu32 " levels, step 2^%" PRId32
                       " do not fit a %s field",
                       file->path, header->brick_size, header->block_count, header->level_count, header->step_exponent,
                       df_field_kind_name((df_field_kind)header->kind));
    }
    field->kind = (df_field_kind)header->kind;
    field->sample_type = (df_sample_type)header->sample_type;
    field->verdict = (df_verdict)header->verdict;
    field->brick_size = header->brick_size;
    if (header->kind == DF_FIELD_ADF) field->family_count = header->block_count;
    else field->brick_count = header->block_count;
    field->level_count = header->level_count;
    field->exact_count = header->exact_count;
    field->step_exponent = header->step_exponent;
    field->error_max = header->error_max;
    field->error_rms = header->error_rms;
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = header->voxel_count[a];
        field->voxel_size[a] = header->voxel_size[a];
        field->origin[a] = header->origin[a];
        if (field->voxel_count[a] < 1 || field->voxel_count[a] > DF_VOXEL_COUNT_MAX) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu32 " voxels along axis %d (1 to %u are possible)",
                           file->path, field->voxel_count[a], a, DF_VOXEL_COUNT_MAX);
        }
    }
    return DF_OK;
}

static df_status take_provenance(const source *file, df_field *field, df_error *err) {
    const df_file_section *section = find_section(file, DF_SECTION_PROVENANCE);
    const void *text = NULL;
    if (!section) return df_fail(err, DF_ERROR_FORMAT, "%s: section PROV is missing", file->path);
    df_status status = copy_section(file, field, DF_SECTION_PROVENANCE, section->size, 1, &text, err);
    if (status != DF_OK) return status;
    json_error_t where;
    json_t *json = json_loadb(text, section->size, 0, &where);
    bool is_object = json_is_object(json);
    json_decref(json);
    if (!is_object) return df_fail(err, DF_ERROR_FORMAT, "%s: the provenance is not a JSON object", file->path);
    field->provenance = text;
    return DF_OK;
}

/* The exponents of bricks or families. */
static df_status take_steps(const source *file, df_field *field, uint32_t block_count, df_error *err) {
    if (field->sample_type == DF_SAMPLE_F32) return DF_OK;
    df_status status =
        copy_section(file, field, DF_SECTION_STEPS, block_count, 1, (const void **)&field->brick_exponents, err);
    for (uint32_t b = 0; status == DF_OK && b < block_count; b++) {
        if (exponent_is_usable(field->brick_exponents[b])) continue;
        status = df_fail(err, DF_ERROR_FORMAT, "%s: block %" PRIu32 " has a step of 2^%d", file->path, b,
                         field->brick_exponents[b]);
    }
    return status;
}

static df_status take_families(const source *file, df_field *field, df_error *err) {
    const void *bytes = NULL;
    df_family *families;
    if (field->exact_count > field->family_count ||
        (field->sample_type == DF_SAMPLE_F32 && field->exact_count < field->family_count)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu32 " of %" PRIu32 " octree families are exact", file->path,
                       field->exact_count, field->family_count);
    }
    df_status status = take_section(file, DF_SECTION_SAMPLES, df_adf_sample_bytes(field), 1, &field->samples, err);
    if (status == DF_OK) status = take_steps(file, field, field->family_count - field->exact_count, err);
    if (status == DF_OK) status = take_section(file, DF_SECTION_FAMILIES, field->family_count, 1, &bytes, err);
    if (status == DF_OK) status = df_alloc((void **)&families, field->family_count, sizeof *families, file->path, err);
    if (status != DF_OK) return status;
    df_field_own(field, families);
    field->families = families;
    for (uint32_t f = 0; f < field->family_count; f++) {
        for (uint32_t c = 0; c < 8; c++) {
            if (((const uint8_t *)bytes)[f] >> c & 1) families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
        }
    }
    return DF_OK;
}

static bool samples_are_packed(const df_field *field) {
    return field->kind == DF_FIELD_BRICKS && field->sample_type != DF_SAMPLE_F32;
}

static df_status take_bricks(const source *file, df_field *field, df_error *err) {
    uint32_t k = field->brick_size;
    uint64_t cell_total = 1;
    if (k != 4 && k != 8)
        return df_fail(err, DF_ERROR_FORMAT, "%s: brick size %" PRIu32 " (4 and 8 are possible)", file->path, k);
    for (int a = 0; a < 3; a++) cell_total *= (field->voxel_count[a] + k - 1) / k;
    df_status status =
        copy_section(file, field, DF_SECTION_CELLS, cell_total, sizeof(uint32_t), (const void **)&field->cells, err);
    if (status != DF_OK) return status;
    status = take_steps(file, field, field->brick_count, err);
    if (status != DF_OK) return status;
    if (samples_are_packed(field)) {
        const df_file_section *packed = find_section(file, DF_SECTION_PACKED);
        if (!packed) return df_fail(err, DF_ERROR_FORMAT, "%s: section PACK is missing", file->path);
        return df_bricks_unpack(field, file->bytes + packed->offset, packed->size, file->path, err);
    }
    return take_section(file, DF_SECTION_SAMPLES, (uint64_t)field->brick_count * df_brick_sample_count(k),
                        df_sample_size(field->sample_type), &field->samples, err);
}

/* Compares what the file says about its samples with what the samples say. */
static df_status verify_derived(const source *file, const df_field *field, df_error *err) {
    const df_file_header *header = &file->header;
    if (header->sample_count != field->sample_count || header->value_range[0] != field->value_min ||
        header->value_range[1] != field->value_max) {
        return df_fail(err, DF_ERROR_FORMAT,
                       "%s: %" PRIu64 " samples from %g to %g, but the header says %" PRIu64 " from %g to %g",
                       file->path, field->sample_count, (double)field->value_min, (double)field->value_max,
                       header->sample_count, (double)header->value_range[0], (double)header->value_range[1]);
    }
    if (field->kind != DF_FIELD_BRICKS) return DF_OK;
    const void *ranges = NULL, *masks = NULL;
    uint64_t range_size = 2 * sizeof(float), mask_size = df_brick_mask_words(field->brick_size) * sizeof(uint64_t);
    df_status status = take_section(file, DF_SECTION_RANGES, field->brick_count, range_size, &ranges, err);
    if (status == DF_OK) status = take_section(file, DF_SECTION_MASKS, field->brick_count, mask_size, &masks, err);
    if (status != DF_OK) return status;
    if (memcmp(ranges, field->brick_ranges, field->brick_count * range_size) != 0) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: section RANG does not fit the samples", file->path);
    }
    if (memcmp(masks, field->brick_masks, field->brick_count * mask_size) != 0) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: section MASK does not fit the samples", file->path);
    }
    return DF_OK;
}

static df_status read_body(source *file, df_read_mode mode, df_field *field, df_error *err) {
    df_status status = fill_from_header(file, field, err);
    if (status == DF_OK) status = check_sections_known(file, err);
    if (status == DF_OK) status = load_bytes(file, mode, field, err);
    if (status == DF_OK) status = verify_body(file, mode == DF_READ_MAP, err);
    if (status == DF_OK) status = verify_padding(file, err);
    if (status == DF_OK) status = take_provenance(file, field, err);
    if (status != DF_OK) return status;
    if (field->kind == DF_FIELD_BRICKS) {
        status = take_bricks(file, field, err);
    } else if (field->kind == DF_FIELD_ADF) {
        status = take_families(file, field, err);
    } else {
        status = take_section(file, DF_SECTION_SAMPLES, df_dense_sample_count(field->voxel_count),
                              df_sample_size(field->sample_type), &field->samples, err);
    }
    if (status == DF_OK) status = df_field_finish(field, file->path, err);
    if (status == DF_OK) status = verify_derived(file, field, err);
    if (status != DF_OK) return status;
    const df_file_section *crcs = &file->sections[file->header.section_count - 1];
    field->checksum = df_crc32c(file->header.header_crc, file->bytes + crcs->offset, crcs->size);
    if (samples_are_packed(field)) drop_bytes(file, field);
    return DF_OK;
}

df_status df_field_read(const char *path, df_read_mode mode, df_field *field, df_error *err) {
    source file;
    *field = (df_field){0};
    df_status status = open_source(&file, path, err);
    if (status == DF_OK) status = read_table(&file, err);
    if (status == DF_OK) status = read_body(&file, mode, field, err);
    if (file.fd >= 0) close(file.fd);
    if (status != DF_OK) df_field_free(field);
    return status;
}

df_status df_field_sections(const char *path, df_section_info sections[DF_SECTION_COUNT_MAX], uint32_t *count,
                            df_error *err) {
    source file;
    *count = 0;
    df_status status = open_source(&file, path, err);
    if (status == DF_OK) status = read_table(&file, err);
    if (file.fd >= 0) close(file.fd);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < file.header.section_count; i++) {
        memcpy(sections[i].name, &file.sections[i].tag, 4);
        sections[i].name[4] = 0;
        sections[i].offset = file.sections[i].offset;
        sections[i].size = file.sections[i].size;
    }
    *count = file.header.section_count;
    return DF_OK;
}
