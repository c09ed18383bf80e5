#include "common/image.h"
#include "common/output_file.h"

#include <errno.h>
#include <openexr.h>
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* A file that grows in memory, so that every format goes through df_output_buffer. */
typedef struct memory_file {
    uint8_t *data;
    size_t size, capacity;
} memory_file;

/* Writes at an offset; returns 0 when memory is short. */
static int memory_file_put(memory_file *file, const void *data, size_t size, size_t offset) {
    size_t end = offset + size;
    if (end > file->capacity) {
        size_t capacity = end + end / 2 + 4096;
        uint8_t *grown = realloc(file->data, capacity);
        if (!grown) return 0;
        memset(grown + file->capacity, 0, capacity - file->capacity);
        file->data = grown;
        file->capacity = capacity;
    }
    memcpy(file->data + offset, data, size);
    if (end > file->size) file->size = end;
    return 1;
}

/* ---- PNG ---- */

static void png_put(png_structp png, png_bytep data, png_size_t size) {
    memory_file *file = png_get_io_ptr(png);
    if (!memory_file_put(file, data, size, file->size)) png_error(png, "out of memory");
}

static void png_no_flush(png_structp png) { (void)png; }

static void png_on_error(png_structp png, png_const_charp message) {
    char *text = png_get_error_ptr(png);
    snprintf(text, 256, "%s", message);
    png_longjmp(png, 1);
}

/* The part that libpng may leave by longjmp: nothing is allocated here that it does not know. Returns 0 on failure. */
static int encode_png(png_structp png, png_infop info, const uint8_t *rgb, uint32_t width, uint32_t height,
                      png_textp texts, uint32_t text_count) {
    if (setjmp(png_jmpbuf(png))) return 0;
    png_set_user_limits(png, 65536, 65536);
    png_set_IHDR(png, info, width, height, 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    if (text_count) png_set_text(png, info, texts, (int)text_count);
    png_set_compression_level(png, 6);
    png_write_info(png, info);
    for (uint32_t y = 0; y < height; y++) png_write_row(png, rgb + (size_t)y * width * 3);
    png_write_end(png, info);
    return 1;
}

df_status df_image_write_png(const char *path, const uint8_t *rgb, uint32_t width, uint32_t height,
                             const df_image_text *texts, uint32_t text_count, df_error *err) {
    memory_file file = {0};
    char message[256] = "out of memory";
    df_status status = DF_OK;
    png_infop info = NULL;
    png_textp entries = calloc(text_count + 1, sizeof *entries);
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, message, png_on_error, NULL);
    if (png) info = png_create_info_struct(png);
    if (!entries || !png || !info) {
        status = df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", path);
        goto done;
    }
    for (uint32_t i = 0; i < text_count; i++) {
        int ascii = 1;
        for (const char *c = texts[i].value; *c; c++) ascii = ascii && (unsigned char)*c < 128;
        entries[i].compression = ascii ? PNG_TEXT_COMPRESSION_NONE : PNG_ITXT_COMPRESSION_NONE;
        entries[i].key = (char *)texts[i].key;
        entries[i].text = (char *)texts[i].value;
        entries[i].text_length = ascii ? strlen(texts[i].value) : 0;
        entries[i].itxt_length = ascii ? 0 : strlen(texts[i].value);
    }
    png_set_write_fn(png, &file, png_put, png_no_flush);
    if (!encode_png(png, info, rgb, width, height, entries, text_count)) {
        status = df_fail(err, DF_ERROR_MEMORY, "%s: cannot encode: %s", path, message);
        goto done;
    }
    status = df_output_buffer(path, file.data, file.size, err);
done:
    if (png) png_destroy_write_struct(&png, &info);
    free(entries);
    free(file.data);
    return status;
}

/* Keeps the texts of a PNG. Returns 0 when memory is short. */
static int keep_texts(df_image_png *image, png_textp texts, int count) {
    image->texts = calloc((size_t)count + 1, sizeof *image->texts);
    if (!image->texts) return 0;
    for (int i = 0; i < count; i++) {
        image->texts[i].key = strdup(texts[i].key);
        image->texts[i].value = strdup(texts[i].text ? texts[i].text : "");
        image->text_count++;
        if (!image->texts[i].key || !image->texts[i].value) return 0;
    }
    return 1;
}

/* The part of reading that libpng may leave by longjmp; what it allocates belongs to *image. Returns 0 on failure. */
static int decode_png(png_structp png, png_infop info, FILE *file, df_image_png *image) {
    if (setjmp(png_jmpbuf(png))) return 0;
    png_set_user_limits(png, 65536, 65536);
    png_init_io(png, file);
    png_read_info(png, info);
    image->width = png_get_image_width(png, info);
    image->height = png_get_image_height(png, info);
    png_set_expand(png);
    png_set_strip_16(png);
    png_set_strip_alpha(png);
    png_set_gray_to_rgb(png);
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, info);
    if (png_get_rowbytes(png, info) != (size_t)image->width * 3) png_error(png, "unexpected pixel format");
    image->rgb = malloc((size_t)image->width * 3 * image->height);
    if (!image->rgb) png_error(png, "out of memory");
    for (int pass = 0; pass < passes; pass++) {
        for (uint32_t y = 0; y < image->height; y++) png_read_row(png, image->rgb + (size_t)y * image->width * 3, NULL);
    }
    png_read_end(png, info);
    png_textp texts;
    int count;
    png_get_text(png, info, &texts, &count);
    if (!keep_texts(image, texts, count)) png_error(png, "out of memory");
    return 1;
}

df_status df_image_read_png(const char *path, df_image_png *image, df_error *err) {
    unsigned char signature[8];
    char message[256] = "out of memory";
    df_status status = DF_OK;
    png_infop info = NULL;
    memset(image, 0, sizeof *image);
    FILE *file = fopen(path, "rb");
    if (!file) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, message, png_on_error, NULL);
    if (png) info = png_create_info_struct(png);
    if (!png || !info) {
        status = df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", path);
    } else if (fread(signature, 1, sizeof signature, file) != sizeof signature ||
               png_sig_cmp(signature, 0, sizeof signature)) {
        status = df_fail(err, DF_ERROR_FORMAT, "%s: not a PNG file", path);
    } else {
        png_set_sig_bytes(png, sizeof signature);
        if (!decode_png(png, info, file, image))
            status = df_fail(err, DF_ERROR_FORMAT, "%s: damaged PNG: %s", path, message);
    }
    if (status != DF_OK && ferror(file)) status = df_fail(err, DF_ERROR_IO, "%s: cannot read the file", path);
    if (png) png_destroy_read_struct(&png, &info, NULL);
    fclose(file);
    if (status != DF_OK) df_image_png_free(image);
    return status;
}

void df_image_png_free(df_image_png *image) {
    for (uint32_t i = 0; i < image->text_count; i++) {
        free((char *)image->texts[i].key);
        free((char *)image->texts[i].value);
    }
    free(image->texts);
    free(image->rgb);
    memset(image, 0, sizeof *image);
}

const char *df_image_png_text(const df_image_png *image, const char *key) {
    for (uint32_t i = 0; i < image->text_count; i++) {
        if (strcmp(image->texts[i].key, key) == 0) return image->texts[i].value;
    }
    return NULL;
}

/* ---- Portable Float Map ---- */

static df_status write_pfm(const char *path, const float *pixels, uint32_t width, uint32_t height,
                           uint32_t channel_count, df_error *err) {
    char header[64];
    int length = snprintf(header, sizeof header, "%s\n%u %u\n-1.0\n", channel_count == 3 ? "PF" : "Pf", width, height);
    df_output output;
    df_status status = df_output_open(&output, path, err);
    if (status != DF_OK) return status;
    status = df_output_write(&output, header, (size_t)length, err);
    size_t row = (size_t)width * channel_count;
    for (uint32_t y = height; y-- > 0 && status == DF_OK;) { /* the format runs from bottom to top */
        status = df_output_write(&output, pixels + y * row, row * sizeof *pixels, err);
    }
    if (status == DF_OK) return df_output_commit(&output, err);
    df_output_discard(&output);
    return status;
}

/* ---- OpenEXR ---- */

/* OpenEXR 3.1 reads past what it could not allocate for a header's attributes (exr_add_part). They are small: where
 * memory is short they come from a reserve, and what is larger fails as it should. */
static struct {
    _Alignas(16) unsigned char bytes[1 << 13];
    size_t used;
} exr_reserve;

static void *exr_alloc(size_t size) {
    void *memory = malloc(size);
    const size_t rounded = (size + 15) & ~(size_t)15, free_bytes = sizeof exr_reserve.bytes - exr_reserve.used;
    if (memory || size > 512 || rounded > free_bytes) return memory;
    memory = exr_reserve.bytes + exr_reserve.used;
    exr_reserve.used += rounded;
    return memory;
}

static void exr_release(void *memory) {
    const unsigned char *p = memory;
    if (p < exr_reserve.bytes || p >= exr_reserve.bytes + sizeof exr_reserve.bytes) free(memory);
}

static int64_t exr_put(exr_const_context_t context, void *user, const void *data, uint64_t size, uint64_t offset,
                       exr_stream_error_func_ptr_t on_error) {
    if (memory_file_put(user, data, size, offset)) return (int64_t)size;
    on_error(context, EXR_ERR_OUT_OF_MEMORY, "out of memory");
    return -1;
}

static void exr_silent(exr_const_context_t context, exr_result_t code, const char *message) {
    (void)context;
    (void)code;
    (void)message; /* the code comes back from the failing call */
}

/* Encodes one chunk of rows from y on; the pipeline is set up at the first. */
static exr_result_t encode_chunk(exr_context_t context, exr_encode_pipeline_t *pipeline, const float *pixels,
                                 uint32_t width, uint32_t channel_count, uint32_t y) {
    exr_chunk_info_t chunk;
    exr_result_t result = exr_write_scanline_chunk_info(context, 0, (int)y, &chunk);
    if (result != EXR_ERR_SUCCESS) return result;
    result = y == 0 ? exr_encoding_initialize(context, 0, &chunk, pipeline)
                    : exr_encoding_update(context, 0, &chunk, pipeline);
    if (result != EXR_ERR_SUCCESS) return result;
    for (uint32_t c = 0; c < channel_count; c++) {
        exr_coding_channel_info_t *channel = &pipeline->channels[c]; /* sorted by name: X, Y, Z */
        channel->encode_from_ptr = (const uint8_t *)(pixels + (size_t)y * width * channel_count + c);
        channel->user_pixel_stride = (int32_t)(channel_count * sizeof *pixels);
        channel->user_line_stride = (int32_t)(channel_count * sizeof *pixels * width);
        channel->user_bytes_per_element = sizeof *pixels;
        channel->user_data_type = EXR_PIXEL_FLOAT;
    }
    if (y == 0) result = exr_encoding_choose_default_routines(context, 0, pipeline);
    return result == EXR_ERR_SUCCESS ? exr_encoding_run(context, 0, pipeline) : result;
}

static exr_result_t encode_exr(exr_context_t context, const float *pixels, uint32_t width, uint32_t height,
                               uint32_t channel_count) {
    static const char *const names[3] = {"X", "Y", "Z"};
    exr_result_t result = exr_add_part(context, "image", EXR_STORAGE_SCANLINE, NULL);
    if (result == EXR_ERR_SUCCESS) {
        result = exr_initialize_required_attr_simple(context, 0, (int32_t)width, (int32_t)height, EXR_COMPRESSION_ZIP);
    }
    for (uint32_t c = 3 - channel_count; c < 3 && result == EXR_ERR_SUCCESS; c++) {
        result = exr_add_channel(context, 0, names[c], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    }
    if (result == EXR_ERR_SUCCESS) result = exr_write_header(context);
    int32_t rows_per_chunk = 1;
    if (result == EXR_ERR_SUCCESS) result = exr_get_scanlines_per_chunk(context, 0, &rows_per_chunk);
    exr_encode_pipeline_t pipeline = EXR_ENCODE_PIPELINE_INITIALIZER;
    for (uint32_t y = 0; y < height && result == EXR_ERR_SUCCESS; y += (uint32_t)rows_per_chunk) {
        result = encode_chunk(context, &pipeline, pixels, width, channel_count, y);
    }
    exr_encoding_destroy(context, &pipeline);
    return result;
}

static df_status write_exr(const char *path, const float *pixels, uint32_t width, uint32_t height,
                           uint32_t channel_count, df_error *err) {
    memory_file file = {0};
    exr_context_t context;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.user_data = &file;
    init.write_fn = exr_put;
    init.error_handler_fn = exr_silent;
    init.alloc_fn = exr_alloc;
    init.free_fn = exr_release;
    exr_reserve.used = 0;
    exr_result_t result = exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (result == EXR_ERR_SUCCESS) {
        result = encode_exr(context, pixels, width, height, channel_count);
        exr_result_t finished = exr_finish(&context);
        if (result == EXR_ERR_SUCCESS) result = finished;
    }
    df_status status = result == EXR_ERR_SUCCESS ? df_output_buffer(path, file.data, file.size, err)
                                                 : df_fail(err, DF_ERROR_IO, "%s: cannot encode: %s", path,
                                                           exr_get_default_error_message(result));
    free(file.data);
    return status;
}

static int ends_with(const char *path, const char *extension) {
    size_t length = strlen(path), tail = strlen(extension);
    return length > tail && strcasecmp(path + length - tail, extension) == 0;
}

int df_image_is_float_path(const char *path) { return ends_with(path, ".pfm") || ends_with(path, ".exr"); }

df_status df_image_write_float(const char *path, const float *pixels, uint32_t width, uint32_t height,
                               uint32_t channel_count, df_error *err) {
    if (ends_with(path, ".pfm")) return write_pfm(path, pixels, width, height, channel_count, err);
    if (ends_with(path, ".exr")) return write_exr(path, pixels, width, height, channel_count, err);
    return df_fail(err, DF_ERROR_USAGE, "%s: expected a name that ends in .exr or .pfm", path);
}
