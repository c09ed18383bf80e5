#include "common/brick_pack.h"
#include "common/digest.h"
#include "common/field_file.h"
#include "common/field_layout.h"
#include "common/memory.h"
#include "common/output_file.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

/* What the body of the file consists of: sections in order, and the zeros between them. */
typedef struct layout {
    df_file_section sections[8];
    const void *data[8];
    uint32_t count;
    uint64_t end; /* of the last section so far */
} layout;

static void add_section(layout *file, uint32_t tag, const void *data, uint64_t size) {
    assert(file->count < 8);
    file->sections[file->count] = (df_file_section){.tag = tag, .offset = df_file_align(file->end), .size = size};
    file->data[file->count] = data;
    file->end = file->sections[file->count].offset + size;
    file->count++;
}

/* Offset of the first byte after header and table, where the checksummed body begins. */
static uint64_t body_begin(uint32_t section_count) {
    return df_file_align(sizeof(df_file_header) + section_count * sizeof(df_file_section));
}

/* CRCs of the body cut into blocks of DF_FILE_CRC_BLOCK, while it lies scattered in memory. */
static void checksum_body(const layout *file, uint64_t begin, uint32_t *crcs) {
    static const uint8_t zeros[DF_FILE_ALIGNMENT];
    uint64_t at = begin;
    for (uint32_t s = 0; s < file->count; s++) {
        uint64_t next = s + 1 < file->count ? file->sections[s + 1].offset : df_file_align(file->end);
        while (at < next) {
            uint64_t inside = at - file->sections[s].offset, left = file->sections[s].size - inside;
            bool padding = inside >= file->sections[s].size;
            uint64_t block = (at - begin) / DF_FILE_CRC_BLOCK, block_end = begin + (block + 1) * DF_FILE_CRC_BLOCK;
            uint64_t part = padding ? next - at : left;
            if (part > block_end - at) part = block_end - at;
            crcs[block] = df_crc32c(crcs[block], padding ? zeros : (const uint8_t *)file->data[s] + inside, part);
            at += part;
        }
    }
}

static void fill_header(const df_field *field, const layout *file, df_file_header *header) {
    *header = (df_file_header){.version = DF_FILE_VERSION, .endian_tag = DF_FILE_ENDIAN_TAG};
    memcpy(header->magic, DF_FILE_MAGIC, sizeof header->magic);
    header->file_size = file->end;
    header->section_count = file->count;
    header->kind = field->kind;
    header->sample_type = field->sample_type;
    header->brick_size = field->brick_size;
    header->verdict = field->verdict;
    for (int a = 0; a < 3; a++) {
        header->voxel_count[a] = field->voxel_count[a];
        header->voxel_size[a] = field->voxel_size[a];
        header->origin[a] = field->origin[a];
    }
    header->value_range[0] = field->value_min;
    header->value_range[1] = field->value_max;
    header->step_exponent = field->step_exponent;
    header->block_count = field->kind == DF_FIELD_ADF ? field->family_count : field->brick_count;
    header->level_count = field->level_count;
    header->exact_count = field->exact_count;
    header->sample_count = field->sample_count;
    header->error_max = field->error_max;
    header->error_rms = field->error_rms;
    header->table_crc = df_crc32c(0, file->sections, file->count * sizeof file->sections[0]);
    header->header_crc = df_crc32c(0, header, sizeof *header - sizeof header->header_crc);
}

/* What files hold in another form than memory. */
typedef struct stored_form {
    uint8_t *divided; /* of an ADF, by family: a bit for each child that is divided */
    uint8_t *packed;  /* samples of u16 and u8 bricks */
    uint64_t packed_size;
} stored_form;

static void add_field_sections(const df_field *field, const stored_form *form, layout *file) {
    if (field->kind == DF_FIELD_BRICKS) {
        uint64_t cell_total = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2];
        uint64_t words = (uint64_t)field->brick_count * df_brick_mask_words(field->brick_size);
        add_section(file, DF_SECTION_CELLS, field->cells, cell_total * sizeof *field->cells);
        add_section(file, DF_SECTION_RANGES, field->brick_ranges, (uint64_t)field->brick_count * 2 * sizeof(float));
        add_section(file, DF_SECTION_MASKS, field->brick_masks, words * sizeof *field->brick_masks);
        if (field->brick_exponents) add_section(file, DF_SECTION_STEPS, field->brick_exponents, field->brick_count);
    }
    if (field->kind == DF_FIELD_ADF) {
        add_section(file, DF_SECTION_FAMILIES, form->divided, field->family_count);
        if (field->brick_exponents) {
            add_section(file, DF_SECTION_STEPS, field->brick_exponents, field->family_count - field->exact_count);
        }
        add_section(file, DF_SECTION_SAMPLES, field->samples, df_adf_sample_bytes(field));
    } else if (form->packed) {
        add_section(file, DF_SECTION_PACKED, form->packed, form->packed_size);
    } else {
        add_section(file, DF_SECTION_SAMPLES, field->samples, field->sample_count * df_sample_size(field->sample_type));
    }
    add_section(file, DF_SECTION_PROVENANCE, field->provenance, strlen(field->provenance));
}

static df_status list_divided(const df_field *field, uint8_t **divided, df_error *err) {
    df_status status = df_alloc((void **)divided, field->family_count, 1, "octree", err);
    for (uint32_t f = 0; status == DF_OK && f < field->family_count; f++) {
        for (uint32_t c = 0; c < 8; c++) {
            (*divided)[f] |= (uint8_t)((df_family_state(&field->families[f], c) == DF_CHILD_FAMILY) << c);
        }
    }
    return status;
}

static df_status find_stored_form(const df_field *field, const char *path, stored_form *form, df_error *err) {
    df_status status = list_divided(field, &form->divided, err);
    if (status == DF_OK && field->kind == DF_FIELD_BRICKS && field->sample_type != DF_SAMPLE_F32) {
        status = df_bricks_pack(field, &form->packed, &form->packed_size, path, err);
    }
    return status;
}

static df_status write_padded(df_output *output, uint64_t *at, uint64_t offset, const void *data, uint64_t size,
                              df_error *err) {
    static const uint8_t zeros[DF_FILE_ALIGNMENT];
    assert(offset - *at < DF_FILE_ALIGNMENT);
    df_status status = df_output_write(output, zeros, offset - *at, err);
    if (status == DF_OK) status = df_output_write(output, data, size, err);
    *at = offset + size;
    return status;
}

df_status df_field_write(df_field *field, const char *path, df_error *err) {
    assert(field->provenance && field->samples);
    stored_form form = {0};
    uint32_t *crcs = NULL;
    df_status status = find_stored_form(field, path, &form, err);
    if (status != DF_OK) goto done;
    /* Section offsets depend on the size of the table, hence on the number of sections. */
    layout file = {0};
    add_field_sections(field, &form, &file);
    uint32_t section_count = file.count + 1;
    uint64_t begin = body_begin(section_count);
    file = (layout){.end = begin};
    add_field_sections(field, &form, &file);
    uint64_t block_count = (df_file_align(file.end) - begin + DF_FILE_CRC_BLOCK - 1) / DF_FILE_CRC_BLOCK;
    status = df_alloc((void **)&crcs, block_count, sizeof *crcs, "checksums", err);
    if (status != DF_OK) goto done;
    checksum_body(&file, begin, crcs);
    add_section(&file, DF_SECTION_CHECKSUMS, crcs, block_count * sizeof *crcs);
    file.sections[file.count - 1].crc = df_crc32c(0, crcs, block_count * sizeof *crcs);

    df_file_header header;
    df_output output;
    uint64_t at = 0;
    fill_header(field, &file, &header);
    status = df_output_open(&output, path, err);
    if (status != DF_OK) goto done;
    status = write_padded(&output, &at, 0, &header, sizeof header, err);
    if (status == DF_OK) {
        status = write_padded(&output, &at, sizeof header, file.sections, file.count * sizeof file.sections[0], err);
    }
    for (uint32_t s = 0; s < file.count && status == DF_OK; s++) {
        status = write_padded(&output, &at, file.sections[s].offset, file.data[s], file.sections[s].size, err);
    }
    if (status == DF_OK) status = df_output_commit(&output, err);
    else df_output_discard(&output);
    if (status == DF_OK) field->checksum = df_crc32c(header.header_crc, crcs, block_count * sizeof *crcs);
done:
    free(form.divided);
    free(form.packed);
    free(crcs);
    return status;
}
