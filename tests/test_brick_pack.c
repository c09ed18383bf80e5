/* Claims about packed bricks: nothing is lost, and nothing that is no packing is unpacked. */
#include "common/brick_pack.h"
#include "fields.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const uint32_t SIZE[3] = {21, 13, 18};

static uint32_t seed = 1;
static uint32_t noise(void) {
    seed = seed * 1664525u + 1013904223u;
    return seed >> 8;
}

static void make(df_field *field, uint32_t brick_size, df_sample_type type) {
    df_error err = {0};
    assert_int_equal(test_field_sphere(field, DF_FIELD_BRICKS, brick_size, SIZE, 5.3, &err), DF_OK);
    assert_int_equal(test_field_quantise(field, type, &err), DF_OK);
    assert_in_range(field->brick_count, 8, 1000);
}

/* A field that consists of one brick alone, so that all samples are its own. */
static void make_single(df_field *field, df_sample_type type) {
    df_error err = {0};
    assert_int_equal(test_field_sphere(field, DF_FIELD_BRICKS, 8, (uint32_t[3]){8, 8, 8}, 2, &err), DF_OK);
    assert_int_equal(test_field_quantise(field, type, &err), DF_OK);
    assert_int_equal(field->brick_count, 1);
}

static size_t bytes_of(const df_field *field) { return field->sample_count * df_sample_size(field->sample_type); }

/* Unpacks from memory that ends where the bytes do, so that sanitizers see a step past it. */
static df_status unpack(const df_field *like, const uint8_t *bytes, uint64_t size, df_field *field) {
    df_error err = {0};
    uint8_t *exact = malloc(size ? size : 1);
    memcpy(exact, bytes, size);
    *field = *like;
    field->samples = NULL;
    df_status status = df_bricks_unpack(field, exact, size, "packed", &err);
    free(exact);
    if (status == DF_OK) assert_non_null(field->samples);
    else assert_true(status == DF_ERROR_FORMAT && !field->samples && err.text[0]);
    return status;
}

/* Of a field that was unpacked with the memory of another one: only the samples are its own. */
static void forget(df_field *field) {
    free((void *)field->samples);
    field->samples = NULL;
}

static void comes_back(const df_field *field, uint64_t *size) {
    df_field back;
    df_error err = {0};
    uint8_t *bytes;
    assert_int_equal(df_bricks_pack(field, &bytes, size, "field", &err), DF_OK);
    assert_non_null(bytes);
    assert_true(*size * DF_PACK_RATIO_MAX >= bytes_of(field));
    assert_int_equal(unpack(field, bytes, *size, &back), DF_OK);
    assert_memory_equal(back.samples, field->samples, bytes_of(field));
    forget(&back);
    free(bytes);
}

static void all_samples_come_back(void **state) {
    (void)state;
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        for (uint32_t k = 4; k <= 8; k += 4) {
            df_field field;
            uint64_t size;
            make(&field, k, (df_sample_type)type);
            comes_back(&field, &size);
            assert_true(size < bytes_of(&field));
            df_field_free(&field);
        }
    }
}

/* A step finer by a power of two, with the same values. */
static void refine(df_field *field, uint32_t brick, int by) {
    const uint32_t count = df_brick_sample_count(field->brick_size);
    uint16_t *q = (uint16_t *)field->samples + (size_t)brick * count;
    ((int8_t *)field->brick_exponents)[brick] = (int8_t)(field->brick_exponents[brick] - by);
    for (uint32_t i = 0; i < count; i++) q[i] = (uint16_t)(32768 + (q[i] - 32768) * (1 << by));
}

static void bricks_of_different_steps_come_back(void **state) {
    (void)state;
    df_field field;
    uint64_t size;
    make(&field, 8, DF_SAMPLE_U16);
    for (uint32_t b = 0; b < field.brick_count; b++) refine(&field, b, (int)(noise() % 8));
    comes_back(&field, &size);
    df_field_free(&field);
}

static void a_step_that_cannot_hold_what_is_shared_is_refused(void **state) {
    (void)state;
    df_field field, back;
    df_error err = {0};
    uint8_t *bytes;
    uint64_t size;
    make(&field, 4, DF_SAMPLE_U16);
    assert_int_equal(df_bricks_pack(&field, &bytes, &size, "field", &err), DF_OK);
    int8_t *last = (int8_t *)field.brick_exponents + field.brick_count - 1, was = *last;
    for (*last = -126; *last < 100; *last = (int8_t)(*last + 1)) {
        /* twice the step: odd numbers have no half; 2^-16 of it: their multiples do not fit */
        bool possible = *last > was - 16 && *last <= was;
        df_status status = unpack(&field, bytes, size, &back);
        if (!possible) assert_int_equal(status, DF_ERROR_FORMAT);
        if (*last == was) assert_int_equal(status, DF_OK);
        forget(&back);
    }
    free(bytes);
    *last = was;
    df_field_free(&field);
}

/* Rows of every width, and sums that leave the range of samples on their way. */
static void rows_of_all_widths_come_back(void **state) {
    (void)state;
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        const int bits = type == DF_SAMPLE_U16 ? 16 : 8;
        for (int width = 0; width <= bits; width++) {
            df_field field;
            uint64_t size;
            make_single(&field, (df_sample_type)type);
            memset((void *)field.samples, 0, bytes_of(&field));
            for (uint32_t i = 0; i < 9; i++) {
                const uint32_t q = noise() & ((1u << width) - 1);
                if (type == DF_SAMPLE_U16) ((uint16_t *)field.samples)[6 * 81 + 5 * 9 + i] = (uint16_t)q;
                else ((uint8_t *)field.samples)[6 * 81 + 5 * 9 + i] = (uint8_t)q;
            }
            comes_back(&field, &size);
            df_field_free(&field);
        }
    }
}

static void noise_comes_back(void **state) {
    (void)state;
    df_field field;
    uint64_t size;
    make_single(&field, DF_SAMPLE_U16);
    for (size_t i = 0; i < bytes_of(&field); i++) ((uint8_t *)field.samples)[i] = (uint8_t)noise();
    comes_back(&field, &size);
    assert_true(size == (81 * (4 + 9 * 16) + 7) / 8);
    df_field_free(&field);
}

/* Any sample of any brick, changed alone: where others hold it too, there is no packing; where not, it comes back. */
static void only_bricks_that_agree_are_packed(void **state) {
    (void)state;
    df_field field;
    df_error err = {0};
    make(&field, 4, DF_SAMPLE_U16);
    uint16_t *q = (uint16_t *)field.samples;
    uint64_t torn = 0, whole = 0;
    for (uint64_t i = 0; i < field.sample_count; i++) {
        uint8_t *bytes;
        uint64_t size;
        q[i] ^= 1;
        const bool inner = i % 5 % 4 && i / 5 % 5 % 4 && i / 25 % 5 % 4;
        const df_status status = df_bricks_pack(&field, &bytes, &size, "field", &err);
        if (inner) assert_int_equal(status, DF_OK);
        if (status == DF_OK) comes_back(&field, &size);
        else assert_true(status == DF_ERROR_INPUT && !bytes && err.text[0]);
        torn += status != DF_OK;
        whole += status == DF_OK;
        free(bytes);
        q[i] ^= 1;
    }
    assert_true(torn > 1000 && whole > 1000);
    df_field_free(&field);
}

static void every_other_length_is_refused(void **state) {
    (void)state;
    for (int smooth = 0; smooth < 2; smooth++) {
        df_field field, back;
        df_error err = {0};
        uint8_t *bytes;
        uint64_t size;
        make(&field, 8, DF_SAMPLE_U16);
        /* equal samples need less than the least size, and zeros make up for it; noise where no brick shares needs more
         */
        for (uint64_t i = 0; i < field.sample_count; i++) {
            const bool inner = i % 9 % 8 && i / 9 % 9 % 8 && i / 81 % 9 % 8;
            ((uint16_t *)field.samples)[i] = (uint16_t)(32768 + (inner && !smooth ? noise() % 1024 : 0));
        }
        assert_int_equal(df_bricks_pack(&field, &bytes, &size, "field", &err), DF_OK);
        assert_non_null(bytes);
        assert_int_equal(smooth, size == (bytes_of(&field) + 2) / 3);
        for (uint64_t length = 0; length < size; length++) {
            assert_int_equal(unpack(&field, bytes, length, &back), DF_ERROR_FORMAT);
        }
        uint8_t *longer = calloc(1, size + 9);
        memcpy(longer, bytes, size);
        for (uint64_t more = 1; more <= 9; more++) {
            assert_int_equal(unpack(&field, longer, size + more, &back), DF_ERROR_FORMAT);
        }
        if (smooth) {
            longer[size - 1] = 1;
            assert_int_equal(unpack(&field, longer, size, &back), DF_ERROR_FORMAT);
        }
        free(longer);
        free(bytes);
        df_field_free(&field);
    }
}

/* Whatever the bytes and the cells say: refused, or unpacked to some samples. */
static void damage_is_refused_or_harmless(void **state) {
    (void)state;
    df_field field, back;
    df_error err = {0};
    uint8_t *bytes;
    uint64_t size;
    uint32_t refused = 0;
    make(&field, 4, DF_SAMPLE_U16);
    assert_int_equal(df_bricks_pack(&field, &bytes, &size, "field", &err), DF_OK);
    for (uint64_t bit = 0; bit < size * 8; bit++) {
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
        refused += unpack(&field, bytes, size, &back) != DF_OK;
        forget(&back);
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
    }
    assert_true(refused > 100);
    const uint64_t cell_total = (uint64_t)field.cell_count[0] * field.cell_count[1] * field.cell_count[2];
    for (uint64_t i = 0; i < cell_total; i++) {
        uint32_t *cell = (uint32_t *)field.cells + i, was = *cell;
        const uint32_t tokens[] = {was - 1, was + 1, field.brick_count, DF_CELL_INSIDE - 1};
        for (size_t t = 0; t < sizeof tokens / sizeof tokens[0]; t++) {
            if (tokens[t] >= DF_CELL_INSIDE) continue;
            *cell = tokens[t];
            assert_int_equal(unpack(&field, bytes, size, &back), DF_ERROR_FORMAT);
        }
        if (was < DF_CELL_INSIDE) {
            *cell = DF_CELL_OUTSIDE;
            assert_int_equal(unpack(&field, bytes, size, &back), DF_ERROR_FORMAT);
        }
        *cell = was;
    }
    free(bytes);
    df_field_free(&field);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_samples_come_back),
        cmocka_unit_test(bricks_of_different_steps_come_back),
        cmocka_unit_test(a_step_that_cannot_hold_what_is_shared_is_refused),
        cmocka_unit_test(rows_of_all_widths_come_back),
        cmocka_unit_test(noise_comes_back),
        cmocka_unit_test(only_bricks_that_agree_are_packed),
        cmocka_unit_test(every_other_length_is_refused),
        cmocka_unit_test(damage_is_refused_or_harmless),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
