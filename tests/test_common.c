/* Claims about the small parts of common/: options, checksums, output files, trilinear interpolation. */
#include "common/digest.h"
#include "common/field.h"
#include "common/image.h"
#include "common/interrupt.h"
#include "common/memory.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/progress.h"

#include <dirent.h>
#include <fcntl.h>
#include <pthread.h>
#include <pty.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

static char folder[] = "/tmp/df_test_common_XXXXXX";

static const char *in_folder(const char *name) {
    static char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static int entries_in_folder(void) {
    int count = 0;
    DIR *dir = opendir(folder);
    while (readdir(dir)) count++;
    closedir(dir);
    return count - 2;
}

static void crc32c_equals_the_published_check_value(void **state) {
    (void)state;
    assert_int_equal(df_crc32c(0, "123456789", 9), 0xE3069283u);
    assert_int_equal(df_crc32c(df_crc32c(0, "1234", 4), "56789", 5), 0xE3069283u);
}

static void sha256_equals_the_published_value(void **state) {
    (void)state;
    char hex[65];
    df_error err = {0};
    assert_int_equal(df_output_buffer(in_folder("abc"), "abc", 3, &err), DF_OK);
    assert_int_equal(df_sha256_file(in_folder("abc"), hex, &err), DF_OK);
    assert_string_equal(hex, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    unlink(in_folder("abc"));
}

static void numbers_with_trailing_text_or_out_of_range_are_refused(void **state) {
    (void)state;
    static const char *const wrong[] = {"",     "0", "-1", "1e9", "12x", " 3", "65537", "18446744073709551616",
                                        "0x10", "+5"};
    uint32_t value;
    df_error err = {0};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(df_parse_u32("--resolution", wrong[i], 1, 65536, &value, &err), DF_ERROR_USAGE);
    }
    assert_int_equal(df_parse_u32("--resolution", "256", 1, 65536, &value, &err), DF_OK);
    assert_int_equal(value, 256);
    double number;
    static const char *const not_numbers[] = {"", "nan", "inf", "1e999", "1,5", "2 "};
    for (size_t i = 0; i < sizeof not_numbers / sizeof not_numbers[0]; i++) {
        assert_int_equal(df_parse_double("--iso", not_numbers[i], -10, 10, &number, &err), DF_ERROR_USAGE);
    }
    uint32_t width, height;
    static const char *const not_sizes[] = {"", "10", "10x", "x10", "0x10", "10x0", "10x10x10", "-1x5", "70000x1"};
    for (size_t i = 0; i < sizeof not_sizes / sizeof not_sizes[0]; i++) {
        assert_int_equal(df_parse_size("--size", not_sizes[i], &width, &height, &err), DF_ERROR_USAGE);
    }
    assert_int_equal(df_parse_size("--size", "1280x1024", &width, &height, &err), DF_OK);
    assert_int_equal(width * 10000 + height, 12801024);
}

static void extensions_are_replaced_in_the_name_only(void **state) {
    (void)state;
    static const char *const cases[][2] = {
        {"a.b/c", "a.b/c.png"}, {"x.obj", "x.png"}, {"d/x.y.obj", "d/x.y.png"}, {".hidden", ".hidden.png"}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        char *path = df_path_with_extension(cases[i][0], ".png", 1);
        assert_string_equal(path, cases[i][1]);
        free(path);
    }
    char *bare = df_path_with_extension("d/x.obj", ".png", 0);
    assert_string_equal(bare, "x.png");
    free(bare);
}

static void a_discarded_output_leaves_the_old_file_and_nothing_else(void **state) {
    (void)state;
    df_error err = {0};
    char text[8] = "";
    const char *path = in_folder("out");
    assert_int_equal(df_output_buffer(path, "old", 3, &err), DF_OK);
    df_output output;
    assert_int_equal(df_output_open(&output, path, &err), DF_OK);
    assert_int_equal(df_output_write(&output, "new", 3, &err), DF_OK);
    df_output_discard(&output);
    assert_int_equal(entries_in_folder(), 1);
    FILE *file = fopen(path, "r");
    assert_int_equal(fread(text, 1, 7, file), 3);
    fclose(file);
    assert_string_equal(text, "old");
    unlink(path);
}

static void links_are_followed_and_modes_kept(void **state) {
    (void)state;
    df_error err = {0};
    struct stat info;
    char target[256], link_path[256];
    snprintf(target, sizeof target, "%s/target", folder);
    snprintf(link_path, sizeof link_path, "%s/link", folder);
    assert_int_equal(symlink("target", link_path), 0);
    assert_int_equal(df_output_buffer(link_path, "first", 5, &err), DF_OK); /* a dangling link */
    assert_int_equal(chmod(target, 0640), 0);
    assert_int_equal(df_output_buffer(link_path, "second", 6, &err), DF_OK);
    assert_int_equal(lstat(link_path, &info), 0);
    assert_true(S_ISLNK(info.st_mode));
    assert_int_equal(stat(target, &info), 0);
    assert_int_equal(info.st_size, 6);
    assert_int_equal(info.st_mode & 07777, 0640);
    unlink(link_path);
    unlink(target);
}

static void devices_are_written_and_stay_devices(void **state) {
    (void)state;
    df_error err = {0};
    struct stat info;
    assert_int_equal(df_output_buffer("/dev/null", "x", 1, &err), DF_OK);
    assert_int_equal(df_output_buffer("/dev/full", "x", 1, &err), DF_ERROR_IO);
    assert_non_null(strstr(err.text, "/dev/full"));
    assert_int_equal(stat("/dev/null", &info), 0);
    assert_true(S_ISCHR(info.st_mode));
    assert_int_equal(stat("/dev/full", &info), 0);
    assert_true(S_ISCHR(info.st_mode));
}

static void folders_and_missing_folders_are_refused(void **state) {
    (void)state;
    df_error err = {0};
    df_output output;
    assert_int_equal(df_output_open(&output, folder, &err), DF_ERROR_IO);
    assert_int_equal(df_output_open(&output, in_folder("no/such/file"), &err), DF_ERROR_IO);
    assert_int_equal(df_output_check(folder, &err), DF_ERROR_IO);
    assert_int_equal(df_output_check(in_folder("no/such/file"), &err), DF_ERROR_IO);
    assert_int_equal(df_output_check(in_folder("fine"), &err), DF_OK);
}

static void a_file_size_limit_ends_in_an_error_and_no_file(void **state) {
    (void)state;
    pid_t child = fork();
    if (child == 0) {
        struct rlimit limit = {1000, 1000};
        signal(SIGXFSZ, SIG_IGN);
        setrlimit(RLIMIT_FSIZE, &limit);
        static char data[5000];
        df_error err = {0};
        _exit(df_output_buffer(in_folder("large"), data, sizeof data, &err) == DF_ERROR_IO ? 0 : 1);
    }
    int status;
    waitpid(child, &status, 0);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    assert_int_equal(entries_in_folder(), 0);
}

static pthread_barrier_t meeting;

static void *read_beyond_the_end(void *mapping) {
    pthread_barrier_wait(&meeting);
    return (void *)(uintptr_t) * (volatile char *)mapping;
}

/* The child of the test below: never returns. */
static void map_a_file_that_ends(const char *path, int messages) {
    pthread_t threads[4];
    const int fd = open(path, O_RDONLY);
    void *mapping = mmap(NULL, 4096, PROT_READ, MAP_SHARED, fd, 0);
    dup2(messages, STDERR_FILENO);
    df_interrupt_guard_mapping(path);
    pthread_barrier_init(&meeting, NULL, 4);
    for (int i = 0; i < 4; i++) pthread_create(&threads[i], NULL, read_beyond_the_end, mapping);
    pthread_join(threads[0], NULL);
    _exit(3);
}

/* The messages go to a pipe that is full at first, so that all threads have met the end before the first has spoken. */
static void threads_that_meet_the_end_of_a_mapping_say_one_line(void **state) {
    (void)state;
    df_error err = {0};
    int status, ends[2], lines = 0;
    size_t filled = 0;
    assert_int_equal(df_output_buffer(in_folder("empty"), "", 0, &err), DF_OK);
    assert_int_equal(pipe(ends), 0);
    fcntl(ends[1], F_SETFL, O_NONBLOCK);
    while (write(ends[1], " ", 1) == 1) filled++;
    fcntl(ends[1], F_SETFL, 0);
    const pid_t child = fork();
    if (child == 0) map_a_file_that_ends(in_folder("empty"), ends[1]);
    close(ends[1]);
    usleep(200000);
    size_t size = 0;
    for (char c; read(ends[0], &c, 1) == 1; size++) lines += c == '\n';
    close(ends[0]);
    waitpid(child, &status, 0);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 1);
    assert_true(size > filled);
    assert_int_equal(lines, 1);
    unlink(in_folder("empty"));
}

/* What a progress bar over 100 units, begun a second ago, writes to a standard error that is `stream`. */
static void draw_progress(int stream, bool quiet) {
    const int standard = dup(STDERR_FILENO);
    df_progress progress;
    dup2(stream, STDERR_FILENO);
    df_progress_begin(&progress, "digging", 100, quiet);
    progress.start_ms -= 1000;
    df_progress_add(&progress, 25);
    df_progress_end(&progress);
    dup2(standard, STDERR_FILENO);
    close(standard);
}

/* What comes out of a terminal before an exclamation mark. */
static void read_to_mark(int terminal, char text[256]) {
    size_t size = 0;
    while (size < 255 && read(terminal, text + size, 1) == 1 && text[size] != '!') size++;
    text[size] = 0;
}

static void progress_is_drawn_on_a_terminal_only_and_removed(void **state) {
    (void)state;
    int terminal, program, ends[2];
    char text[256];
    if (openpty(&terminal, &program, NULL, NULL, NULL) != 0) skip();
    draw_progress(program, true);
    assert_int_equal(write(program, "!", 1), 1);
    read_to_mark(terminal, text);
    assert_string_equal(text, "");
    draw_progress(program, false);
    assert_int_equal(write(program, "!", 1), 1);
    read_to_mark(terminal, text);
    assert_ptr_equal(strstr(text, "\rdigging      [=======                       ]  25 %  "), text);
    assert_string_equal(strrchr(text, '\r'), "\r\033[K");
    close(terminal);
    close(program);

    assert_int_equal(pipe(ends), 0);
    draw_progress(ends[1], false);
    close(ends[1]);
    assert_int_equal(read(ends[0], text, sizeof text), 0);
    close(ends[0]);
    df_progress_add(NULL, 1);
}

static void trilinear_is_exact_at_corners_and_on_affine_fields(void **state) {
    (void)state;
    float corners[8], odd[8] = {16777216, -0.3f, 100, -1e-6f, 3e38f, -0.3f, 1, 2};
    for (int c = 0; c < 8; c++) corners[c] = (float)(1 + 2 * (c & 1) - 4 * (c >> 1 & 1) + 8 * (c >> 2));
    for (int i = 0; i < 1000; i++) {
        double local[3] = {i % 10 / 9.0, i / 10 % 10 / 9.0, i / 100 / 9.0}, gradient[3];
        double expected = 1 + 2 * local[0] - 4 * local[1] + 8 * local[2];
        assert_true(df_trilinear(corners, local) - expected < 1e-14 && expected - df_trilinear(corners, local) < 1e-14);
        df_trilinear_gradient(corners, local, gradient);
        for (int a = 0; a < 3; a++) {
            double slope = (double[3]){2, -4, 8}[a];
            assert_true(gradient[a] - slope < 1e-13 && slope - gradient[a] < 1e-13);
        }
    }
    for (int c = 0; c < 8; c++) { /* the convex form keeps the corners, however far apart they lie */
        double local[3] = {c & 1, c >> 1 & 1, c >> 2};
        assert_true(df_trilinear(odd, local) == (double)odd[c]);
    }
}

static void an_allocation_that_overflows_is_refused(void **state) {
    (void)state;
    void *memory;
    df_error err = {0};
    assert_int_equal(df_alloc(&memory, UINT64_MAX / 2, 8, "samples", &err), DF_ERROR_MEMORY);
    assert_null(memory);
    assert_int_equal(df_alloc(&memory, 0, 8, "samples", &err), DF_OK);
    free(memory);
}

static void float_images_say_what_they_are(void **state) {
    (void)state;
    df_error err = {0};
    float pixels[2 * 3 * 3];
    unsigned char magic[4];
    for (int i = 0; i < 18; i++) pixels[i] = (float)i;
    assert_int_equal(df_image_write_float(in_folder("a.exr"), pixels, 2, 3, 3, &err), DF_OK);
    FILE *file = fopen(in_folder("a.exr"), "rb");
    assert_int_equal(fread(magic, 1, 4, file), 4);
    fclose(file);
    assert_memory_equal(magic, "\x76\x2f\x31\x01", 4);
    unlink(in_folder("a.exr"));
    assert_int_equal(df_image_write_float(in_folder("a.pfm"), pixels, 2, 3, 1, &err), DF_OK);
    float first;
    file = fopen(in_folder("a.pfm"), "rb");
    assert_int_equal(fseek(file, -24, SEEK_END), 0);
    assert_int_equal(fread(&first, 4, 1, file), 1);
    fclose(file);
    assert_true(first == pixels[4]); /* the bottom row comes first */
    unlink(in_folder("a.pfm"));
    assert_int_equal(df_image_write_float(in_folder("a.jpg"), pixels, 2, 3, 1, &err), DF_ERROR_USAGE);
}

static int set_up(void **state) {
    (void)state;
    return mkdtemp(folder) ? 0 : 1;
}

static int tear_down(void **state) {
    (void)state;
    return rmdir(folder);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(crc32c_equals_the_published_check_value),
        cmocka_unit_test(sha256_equals_the_published_value),
        cmocka_unit_test(numbers_with_trailing_text_or_out_of_range_are_refused),
        cmocka_unit_test(extensions_are_replaced_in_the_name_only),
        cmocka_unit_test(a_discarded_output_leaves_the_old_file_and_nothing_else),
        cmocka_unit_test(links_are_followed_and_modes_kept),
        cmocka_unit_test(devices_are_written_and_stay_devices),
        cmocka_unit_test(folders_and_missing_folders_are_refused),
        cmocka_unit_test(a_file_size_limit_ends_in_an_error_and_no_file),
        cmocka_unit_test(threads_that_meet_the_end_of_a_mapping_say_one_line),
        cmocka_unit_test(progress_is_drawn_on_a_terminal_only_and_removed),
        cmocka_unit_test(trilinear_is_exact_at_corners_and_on_affine_fields),
        cmocka_unit_test(an_allocation_that_overflows_is_refused),
        cmocka_unit_test(float_images_say_what_they_are),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
