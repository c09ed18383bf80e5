/*
 * The .dfield layout, version 1, as C structs: what field_file_read.c and field_file_write.c share. FORMAT.md explains
 * it. All numbers are little endian; this code runs on little-endian machines only and says so at compile time.
 */
#ifndef DF_FIELD_LAYOUT_H
#define DF_FIELD_LAYOUT_H

#include <assert.h>
#include <stdint.h>

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the .dfield code needs a little-endian machine");

#define DF_FILE_MAGIC \
    "\x89"            \
    "DFIELD\n"
#define DF_FILE_VERSION 1u
#define DF_FILE_ENDIAN_TAG 0x01020304u
#define DF_FILE_ALIGNMENT 64u
#define DF_FILE_CRC_BLOCK (1u << 20) /* bytes under one checksum */

#define DF_SECTION_TAG(a, b, c, d) ((uint32_t)(a) | (uint32_t)(b) << 8 | (uint32_t)(c) << 16 | (uint32_t)(d) << 24)
#define DF_SECTION_CELLS DF_SECTION_TAG('C', 'E', 'L', 'L')
#define DF_SECTION_RANGES DF_SECTION_TAG('R', 'A', 'N', 'G')
#define DF_SECTION_MASKS DF_SECTION_TAG('M', 'A', 'S', 'K')
#define DF_SECTION_STEPS DF_SECTION_TAG('S', 'T', 'E', 'P')
#define DF_SECTION_FAMILIES DF_SECTION_TAG('F', 'A', 'M', 'I')
#define DF_SECTION_SAMPLES DF_SECTION_TAG('S', 'A', 'M', 'P')
#define DF_SECTION_PACKED DF_SECTION_TAG('P', 'A', 'C', 'K') /* samples of u16 and u8 bricks */
#define DF_SECTION_PROVENANCE DF_SECTION_TAG('P', 'R', 'O', 'V')
#define DF_SECTION_CHECKSUMS DF_SECTION_TAG('C', 'R', 'C', 'S')

#define DF_SECTION_OPTIONAL 1u /* flag: a reader that does not know the tag may skip the section */

typedef struct df_file_header {
    char magic[8];
    uint32_t version;
    uint32_t endian_tag;
    uint64_t file_size;
    uint32_t section_count;
    uint32_t kind;
    uint32_t sample_type;
    uint32_t brick_size;
    uint32_t voxel_count[3];
    uint32_t verdict;
    double voxel_size[3];
    double origin[3];
    float value_range[2];
    int32_t step_exponent;
    uint32_t block_count; /* bricks or families */
    uint64_t sample_count;
    double error_max;
    double error_rms;
    uint32_t level_count;
    uint32_t exact_count; /* families stored as floats */
    uint8_t reserved[96];
    uint32_t table_crc;  /* CRC-32C of the section table */
    uint32_t header_crc; /* CRC-32C of the header up to here */
} df_file_header;
static_assert(sizeof(df_file_header) == 256, "header layout");

typedef struct df_file_section {
    uint32_t tag;
    uint32_t flags;
    uint64_t offset; /* from the start of the file, a multiple of 64 */
    uint64_t size;   /* bytes, without padding */
    uint32_t crc;    /* CRC-32C of the section CRCS; 0 for the others, which CRCS covers */
    uint32_t reserved;
} df_file_section;
static_assert(sizeof(df_file_section) == 32, "section layout");

static inline uint64_t df_file_align(uint64_t offset) {
    return (offset + DF_FILE_ALIGNMENT - 1) / DF_FILE_ALIGNMENT * DF_FILE_ALIGNMENT;
}

#endif
