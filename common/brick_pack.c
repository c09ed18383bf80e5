#include "common/brick_pack.h"
#include "common/memory.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLES_MAX = 729, WIDTH_BITS = 4 };

/* A brick between its cell and its bytes. Values are q - q0; `given` says by place (0 lower face, 1 between, 2 upper
 * face along each axis: x + 3(y + 3z)) which of them earlier bricks hold. */
typedef struct brick {
    uint32_t k, index;
    int32_t zero; /* q0 */
    bool given[27];
    int32_t values[SAMPLES_MAX];
} brick;

static int32_t zero_of(df_sample_type type) { return type == DF_SAMPLE_U16 ? 32768 : 128; }

static int32_t load(const df_field *field, const void *samples, uint64_t index) {
    return field->sample_type == DF_SAMPLE_U16 ? ((const uint16_t *)samples)[index] - 32768
                                               : ((const uint8_t *)samples)[index] - 128;
}

/* A value as a sum of them is taken: modulo the range of samples. */
static int32_t wrap(int32_t value, int32_t zero) {
    return (int32_t)((uint32_t)(value + zero) & (2 * (uint32_t)zero - 1)) - zero; /* zero is a power of two */
}

/* ---- samples of earlier bricks ---- */

/* A neighbour's value in steps of 2^-shift of its own; false where that is no whole number in range. */
static bool rescale(int32_t value, int shift, int32_t zero, int32_t *out) {
    *out = value;
    if (value == 0 || shift == 0) return true;
    if (shift < -16 || shift > 16) return false;
    const int64_t scaled = shift < 0 ? value / (1 << -shift) : (int64_t)value * (1 << shift);
    if (scaled < -zero || scaled >= zero || (shift < 0 && scaled * (1 << -shift) != value)) return false;
    *out = (int32_t)scaled;
    return true;
}

/* Copies what brick b shares with an earlier one, in the direction (-1, 0 or 1 along each axis). False where a value is
 * none of its own steps. */
static bool inherit_from(const df_field *field, const void *samples, uint32_t other, const int direction[3], brick *b) {
    const uint32_t k = b->k, side = k + 1;
    const int shift = field->brick_exponents[other] - field->brick_exponents[b->index];
    const uint64_t first = (uint64_t)other * df_brick_sample_count(k);
    uint32_t low[3], high[3];
    int64_t away = 0, stride = 1; /* from a sample to the same one in the other brick */
    for (int a = 0; a < 3; a++, stride *= side) {
        low[a] = direction[a] > 0 ? k : 0;
        high[a] = direction[a] < 0 ? 0 : k;
        away -= direction[a] * (int64_t)k * stride;
    }
    for (uint32_t z = low[2]; z <= high[2]; z++) {
        for (uint32_t y = low[1]; y <= high[1]; y++) {
            for (uint32_t x = low[0]; x <= high[0]; x++) {
                const uint32_t at = x + side * (y + side * z);
                const int32_t value = load(field, samples, first + (uint64_t)(at + away));
                if (!rescale(value, shift, b->zero, &b->values[at])) return false;
            }
        }
    }
    for (int place = 0; place < 27; place++) {
        const int at[3] = {place % 3, place / 3 % 3, place / 9};
        bool shared = true;
        for (int a = 0; a < 3; a++) shared = shared && (direction[a] == 0 || at[a] == direction[a] + 1);
        b->given[place] = b->given[place] || shared;
    }
    return true;
}

/* Starts a brick: the samples that earlier bricks hold, which are those of the 13 cells before its own. */
static bool inherit(const df_field *field, const void *samples, const uint32_t cell_count[3], const uint32_t cell[3],
                    brick *b) {
    memset(b->given, 0, sizeof b->given);
    for (int i = 0; i < 13; i++) {
        const int direction[3] = {i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1};
        int64_t at[3];
        bool exists = true;
        for (int a = 0; a < 3; a++) {
            at[a] = (int64_t)cell[a] + direction[a];
            exists = exists && at[a] >= 0 && at[a] < cell_count[a];
        }
        if (!exists) continue;
        const uint64_t index = (uint64_t)at[0] + cell_count[0] * ((uint64_t)at[1] + cell_count[1] * (uint64_t)at[2]);
        const uint32_t other = field->cells[index];
        if (other < DF_CELL_INSIDE && !inherit_from(field, samples, other, direction, b)) return false;
    }
    return true;
}

/* ---- rows ---- */

/* The samples from *begin to before *end of a row belong to the brick; none where they are equal. */
static void own_part(const brick *b, uint32_t y, uint32_t z, uint32_t *begin, uint32_t *end) {
    const uint32_t k = b->k, row = 3 * ((y == k ? 2 : y > 0) + 3 * (z == k ? 2u : z > 0));
    *begin = *end = 0;
    if (b->given[row + 1]) return; /* then so are the ends, which are samples of the same bricks */
    *begin = b->given[row];
    *end = b->given[row + 2] ? k : k + 1;
}

/* What the rows before tell of a row: value(x) = base[x] + the same difference as at x - 1 + a small one. */
static void row_base(const brick *b, uint32_t y, uint32_t z, int32_t base[9]) {
    static const int32_t none[9];
    assert(b->k >= 1 && b->k <= 8);
    const uint32_t side = b->k + 1;
    const int32_t *row = b->values + side * (y + side * z);
    const int32_t *below = y ? row - side : none, *behind = z ? row - side * side : none;
    const int32_t *both = y && z ? row - side * side - side : none;
    for (uint32_t x = 0; x < side; x++) base[x] = below[x] + behind[x] - both[x];
}

/* The bits that hold a difference as a two's complement number; 0 for 0. */
static uint32_t width_of(int32_t difference) {
    const uint32_t magnitude = (uint32_t)(difference < 0 ? ~difference : difference);
    return difference == 0 ? 0 : magnitude == 0 ? 1 : 33 - (uint32_t)__builtin_clz(magnitude);
}

/* ---- packing ---- */

/* Bits from the lowest of a byte up; `bytes` NULL: they are counted only. */
typedef struct sink {
    uint8_t *bytes;
    uint64_t at; /* bits */
} sink;

static void put_bits(sink *out, uint32_t value, uint32_t count) {
    if (out->bytes) {
        uint8_t *to = out->bytes + out->at / 8;
        for (uint32_t bits = (value & ((1u << count) - 1)) << out->at % 8; bits; bits >>= 8) *to++ |= (uint8_t)bits;
    }
    out->at += count;
}

static void pack_row(const brick *b, uint32_t y, uint32_t z, sink *out) {
    int32_t base[9], differences[9], before = 0;
    uint32_t begin, end, width = 0;
    own_part(b, y, z, &begin, &end);
    if (begin == end) return;
    row_base(b, y, z, base);
    const int32_t *row = b->values + (b->k + 1) * (y + (b->k + 1) * z);
    for (uint32_t x = 0; x < end; x++) {
        differences[x] = wrap(row[x] - base[x] - before, b->zero);
        before = row[x] - base[x];
        if (x >= begin && width_of(differences[x]) > width) width = width_of(differences[x]);
    }
    if (width == 15) width = 16; /* 15 stands for 16 */
    put_bits(out, width == 16 ? 15 : width, WIDTH_BITS);
    for (uint32_t x = begin; x < end; x++) put_bits(out, (uint32_t)differences[x], width);
}

/* False where earlier bricks hold other values. */
static bool pack_brick(const df_field *field, brick *b, sink *out) {
    const uint32_t k = b->k, side = k + 1, at = field->brick_cells[b->index], *count = field->cell_count;
    const uint32_t cell[3] = {at % count[0], at / count[0] % count[1], at / count[0] / count[1]};
    const uint64_t first = (uint64_t)b->index * df_brick_sample_count(k);
    if (!inherit(field, field->samples, count, cell, b)) return false;
    for (uint32_t z = 0; z < side; z++) {
        for (uint32_t y = 0; y < side; y++) {
            uint32_t begin, end, row = side * (y + side * z);
            own_part(b, y, z, &begin, &end);
            for (uint32_t x = 0; x < side; x++) {
                const int32_t value = load(field, field->samples, first + row + x);
                if ((x < begin || x >= end) && b->values[row + x] != value) return false;
                b->values[row + x] = value;
            }
            pack_row(b, y, z, out);
        }
    }
    out->at = (out->at + 7) / 8 * 8;
    return true;
}

static df_status pack_bricks(const df_field *field, sink *out, const char *name, df_error *err) {
    brick b = {.k = field->brick_size, .zero = zero_of(field->sample_type)};
    for (; b.index < field->brick_count; b.index++) {
        if (pack_brick(field, &b, out)) continue;
        return df_fail(err, DF_ERROR_INPUT, "%s: brick %" PRIu32 " disagrees with one before it on a sample", name,
                       b.index);
    }
    return DF_OK;
}

static uint64_t least_size(uint64_t unpacked_size) {
    return (unpacked_size + DF_PACK_RATIO_MAX - 1) / DF_PACK_RATIO_MAX;
}

df_status df_bricks_pack(const df_field *field, uint8_t **bytes, uint64_t *size, const char *name, df_error *err) {
    assert(field->kind == DF_FIELD_BRICKS && field->sample_type != DF_SAMPLE_F32);
    const uint64_t least = least_size(field->sample_count * df_sample_size(field->sample_type));
    sink out = {0};
    *bytes = NULL;
    df_status status = pack_bricks(field, &out, name, err);
    if (status != DF_OK) return status;
    *size = out.at / 8 > least ? out.at / 8 : least;
    status = df_alloc((void **)&out.bytes, *size, 1, "packed samples", err);
    if (status != DF_OK) return status;
    *bytes = out.bytes;
    out.at = 0;
    return pack_bricks(field, &out, name, err);
}

/* ---- unpacking ---- */

typedef struct source {
    const uint8_t *bytes;
    uint64_t size, at; /* bytes; bits */
} source;

/* Up to 16 bits; past the end they are 0. */
static uint32_t peek_bits(const source *in, uint32_t count) {
    const uint64_t byte = in->at / 8;
    uint32_t word = 0;
    if (byte + sizeof word <= in->size) memcpy(&word, in->bytes + byte, sizeof word);
    else if (byte < in->size) memcpy(&word, in->bytes + byte, in->size - byte);
    return word >> in->at % 8 & ((1u << count) - 1);
}

/* False where the row's width is not possible, or the bytes end before it. */
static bool unpack_row(brick *b, uint32_t y, uint32_t z, source *in) {
    int32_t base[9], before = 0;
    uint32_t begin, end;
    own_part(b, y, z, &begin, &end);
    if (begin == end) return true;
    uint32_t width = peek_bits(in, WIDTH_BITS);
    if (width == 15) width = 16;
    in->at += WIDTH_BITS;
    if (in->at + (uint64_t)(end - begin) * width > in->size * 8 || (1u << width) > 2 * (uint32_t)b->zero) return false;
    row_base(b, y, z, base);
    int32_t *row = b->values + (b->k + 1) * (y + (b->k + 1) * z);
    if (begin) before = row[0] - base[0];
    const uint32_t sign = 1u << width >> 1;
    for (uint32_t x = begin; x < end; x++, in->at += width) {
        const int32_t difference = (int32_t)(peek_bits(in, width) ^ sign) - (int32_t)sign;
        row[x] = wrap(base[x] + before + difference, b->zero);
        before = row[x] - base[x];
    }
    return true;
}

static void store(const df_field *field, void *samples, const brick *b) {
    const uint32_t count = df_brick_sample_count(b->k);
    const uint64_t first = (uint64_t)b->index * count;
    for (uint32_t i = 0; i < count; i++) {
        const int32_t q = b->values[i] + b->zero;
        if (field->sample_type == DF_SAMPLE_U16) ((uint16_t *)samples)[first + i] = (uint16_t)q;
        else ((uint8_t *)samples)[first + i] = (uint8_t)q;
    }
}

static df_status unpack_brick(const df_field *field, const uint32_t cell_count[3], const uint32_t cell[3], brick *b,
                              source *in, void *samples, const char *name, df_error *err) {
    const uint32_t side = b->k + 1;
    if (!inherit(field, samples, cell_count, cell, b)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: brick %" PRIu32 " cannot hold the samples that it shares", name,
                       b->index);
    }
    for (uint32_t row = 0; row < side * side; row++) {
        if (unpack_row(b, row % side, row / side, in)) continue;
        return df_fail(err, DF_ERROR_FORMAT, "%s: the packed samples end or break off in brick %" PRIu32, name,
                       b->index);
    }
    const uint32_t rest = (uint32_t)(-in->at % 8);
    if (peek_bits(in, rest)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: bits after brick %" PRIu32 " are not zero", name, b->index);
    }
    in->at += rest;
    store(field, samples, b);
    return DF_OK;
}

static df_status unpack_bricks(const df_field *field, source *in, void *samples, const char *name, df_error *err) {
    brick b = {.k = field->brick_size, .zero = zero_of(field->sample_type)};
    uint32_t count[3], cell[3];
    uint64_t at = 0;
    for (int a = 0; a < 3; a++) count[a] = (field->voxel_count[a] + b.k - 1) / b.k;
    for (cell[2] = 0; cell[2] < count[2]; cell[2]++) {
        for (cell[1] = 0; cell[1] < count[1]; cell[1]++) {
            for (cell[0] = 0; cell[0] < count[0]; cell[0]++, at++) {
                const uint32_t token = field->cells[at];
                if (token >= DF_CELL_INSIDE) continue;
                if (token != b.index || token >= field->brick_count) {
                    return df_fail(err, DF_ERROR_FORMAT,
                                   "%s: coarse cell %" PRIu64 " names brick %" PRIu32 ", expected %" PRIu32
                                   " of %" PRIu32,
                                   name, at, token, b.index, field->brick_count);
                }
                df_status status = unpack_brick(field, count, cell, &b, in, samples, name, err);
                if (status != DF_OK) return status;
                b.index++;
            }
        }
    }
    if (b.index == field->brick_count) return DF_OK;
    return df_fail(err, DF_ERROR_FORMAT, "%s: the coarse cells name %" PRIu32 " of %" PRIu32 " bricks", name, b.index,
                   field->brick_count);
}

/* After the last brick come zeros, and only as many as the least size asks for. */
static df_status check_end(const source *in, uint64_t unpacked_size, const char *name, df_error *err) {
    const uint64_t end = in->at / 8, least = least_size(unpacked_size);
    uint8_t any = 0;
    for (uint64_t i = end; i < in->size; i++) any |= in->bytes[i];
    if (any || in->size != (end > least ? end : least)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu64 " bytes of packed samples, of which %" PRIu64 " are used",
                       name, in->size, end);
    }
    return DF_OK;
}

df_status df_bricks_unpack(df_field *field, const uint8_t *bytes, uint64_t size, const char *name, df_error *err) {
    assert((field->brick_size == 4 || field->brick_size == 8) && field->sample_type != DF_SAMPLE_F32);
    const uint64_t unpacked_size =
        (uint64_t)field->brick_count * df_brick_sample_count(field->brick_size) * df_sample_size(field->sample_type);
    source in = {.bytes = bytes, .size = size};
    void *samples;
    if (size < least_size(unpacked_size)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu64 " bytes of packed samples cannot become %" PRIu64, name,
                       size, unpacked_size);
    }
    df_status status = df_alloc_raw(&samples, unpacked_size, 1, "samples", err);
    if (status == DF_OK) status = unpack_bricks(field, &in, samples, name, err);
    if (status == DF_OK) status = check_end(&in, unpacked_size, name, err);
    if (status != DF_OK) {
        free(samples);
        return status;
    }
    df_field_own(field, samples);
    field->samples = samples;
    return DF_OK;
}
