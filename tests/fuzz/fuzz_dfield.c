/*
 * The .dfield reader. The first byte of the input says how the rest becomes a file: 0 as it is; 1 with checksums
 * recomputed, so that the damage gets past them; 2 with sections moved into place as well, so that it gets past the
 * table.
 */
#include "common/digest.h"
#include "common/field_file.h"
#include "common/field_layout.h"
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static df_file_section *sections_of(uint8_t *file) { return (df_file_section *)(file + sizeof(df_file_header)); }

/* Puts the sections one after the other and gives what is left to CRCS. Returns the size of the file. */
static size_t place_sections(uint8_t *file, size_t size) {
    df_file_header *header = (df_file_header *)file;
    df_file_section *sections = sections_of(file);
    header->section_count = 1 + header->section_count % 8;
    uint64_t end = sizeof *header + header->section_count * sizeof *sections;
    if (end >= size) return size;
    for (uint32_t i = 0; i < header->section_count; i++) {
        sections[i].offset = df_file_align(end);
        if (sections[i].offset > size) return size;
        if (i + 1 == header->section_count) {
            uint64_t body =
                sections[i].offset - df_file_align(sizeof *header + header->section_count * sizeof *sections);
            sections[i].tag = DF_SECTION_CHECKSUMS;
            sections[i].size = (body + DF_FILE_CRC_BLOCK - 1) / DF_FILE_CRC_BLOCK * sizeof(uint32_t);
        }
        if (sections[i].size > size - sections[i].offset) sections[i].size = size - sections[i].offset;
        end = sections[i].offset + sections[i].size;
    }
    return end;
}

static void recompute_checksums(uint8_t *file, size_t size) {
    df_file_header *header = (df_file_header *)file;
    memcpy(header->magic, DF_FILE_MAGIC, sizeof header->magic);
    header->version = DF_FILE_VERSION;
    header->endian_tag = DF_FILE_ENDIAN_TAG;
    header->file_size = size;
    uint64_t table_size = (uint64_t)header->section_count * sizeof(df_file_section);
    if (header->section_count && header->section_count <= DF_SECTION_COUNT_MAX && table_size + sizeof *header <= size) {
        df_file_section *last = sections_of(file) + header->section_count - 1;
        uint64_t begin = df_file_align(sizeof *header + table_size);
        if (last->offset <= size && last->size <= size - last->offset && last->offset >= begin) {
            uint8_t *crcs = file + last->offset;
            for (uint64_t at = begin, i = 0; at < last->offset && (i + 1) * 4 <= last->size;
                 at += DF_FILE_CRC_BLOCK, i++) {
                uint64_t part = last->offset - at < DF_FILE_CRC_BLOCK ? last->offset - at : DF_FILE_CRC_BLOCK;
                uint32_t crc = df_crc32c(0, file + at, part);
                memcpy(crcs + 4 * i, &crc, sizeof crc);
            }
            last->crc = df_crc32c(0, crcs, last->size);
        }
        header->table_crc = df_crc32c(0, sections_of(file), table_size);
    }
    header->header_crc = df_crc32c(0, header, sizeof *header - sizeof header->header_crc);
}

/* Uses a field that the reader let through in every way that could step out of it. */
static void use(const df_field *field) {
    double low[3] = {0, 0, 0}, world[3];
    df_point_info info;
    float iso[2];
    df_field_surface_voxel_count(field);
    df_field_iso_range(field, &iso[0], &iso[1]);
    for (int corner = 0; corner < 8; corner++) {
        for (int a = 0; a < 3; a++) low[a] = corner >> a & 1 ? field->voxel_count[a] : field->voxel_count[a] * 0.37;
        df_field_grid_to_world(field, low, world);
        df_field_query(field, world, &info);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static int fd = -1;
    static char path[64];
    if (size < 1) return 0;
    if (fd < 0) {
        fd = memfd_create("fuzz", 0);
        if (fd < 0) abort();
        snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    }
    int mode = data[0] % 3;
    size_t file_size = size - 1;
    uint8_t *file = aligned_alloc(64, (file_size + 64) / 64 * 64 + 64);
    if (!file) abort();
    memcpy(file, data + 1, file_size);
    if (mode > 0 && file_size >= sizeof(df_file_header)) {
        if (mode == 2) file_size = place_sections(file, file_size);
        recompute_checksums(file, file_size);
    }
    if (ftruncate(fd, (off_t)file_size) != 0 || pwrite(fd, file, file_size, 0) != (ssize_t)file_size) abort();
    free(file);
    for (int copy = 0; copy < 2; copy++) {
        df_field field;
        df_error err = {0};
        if (df_field_read(path, copy ? DF_READ_COPY : DF_READ_MAP, &field, &err) == DF_OK) {
            use(&field);
            df_field_free(&field);
        } else if (!err.text[0]) {
            abort(); /* refused without a reason */
        }
    }
    return 0;
}
