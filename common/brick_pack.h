/*
 * The samples of u16 and u8 bricks in fewer bytes: the section PACK of a .dfield file (FORMAT.md). In memory they stay
 * as they are.
 *
 * A sample that several bricks hold is stored once, by the first of them. The others are differences to what their
 * neighbours in the brick foretell (the Lorenzo predictor: the sum over a cell's other corners with alternating signs,
 * exact for a sum of functions of two coordinates each), in rows of a width of bits each.
 */
#ifndef DF_BRICK_PACK_H
#define DF_BRICK_PACK_H

#include "common/field.h"

/* Packed samples are never less than a part of the unpacked: 1 of so many. It bounds what a small file can ask for. */
#define DF_PACK_RATIO_MAX 3

/* Packs the samples of finished u16 or u8 bricks into a new block, which the caller frees. The bytes depend on the
 * field alone. DF_ERROR_INPUT where bricks disagree on a sample that they share; *bytes = NULL on failure. */
df_status df_bricks_pack(const df_field *field, uint8_t **bytes, uint64_t *size, const char *name, df_error *err);

/* Unpacks the samples of bricks into a new block, which becomes the field's. The field needs voxel_count, sample_type,
 * brick_size, brick_count, brick_exponents and cells, which may hold anything. DF_ERROR_FORMAT where the bytes are not
 * as FORMAT.md says; then field->samples stays as it was. */
df_status df_bricks_unpack(df_field *field, const uint8_t *bytes, uint64_t size, const char *name, df_error *err);

#endif
