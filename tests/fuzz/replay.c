/*
 * Runs a fuzz target without libFuzzer: replay FOLDER [MUTATIONS] feeds it every file of the folder, then that many
 * mutations of each, made from a fixed seed. This is what ctest does with the corpora; pipelines/fuzz searches further.
 */
#include "fuzz.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t state = 0x9E3779B97F4A7C15u;

static uint64_t random_number(void) { /* xorshift64* */
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 0x2545F4914F6CDD1Du;
}

/* Changes some bytes, often to values at which code breaks, and sometimes the length. Returns the new size. */
static size_t mutate(uint8_t *data, size_t size) {
    static const uint8_t edges[] = {0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF, '-', '0', '9', ' ', '\n'};
    uint64_t changes = 1 + random_number() % 4;
    for (uint64_t i = 0; i < changes; i++) {
        size_t at = random_number() % size, length = (size_t)1 << random_number() % 4;
        if (random_number() % 2 && size > 300) at %= 300; /* headers matter most */
        uint8_t value = random_number() % 2 ? edges[random_number() % sizeof edges] : (uint8_t)random_number();
        for (size_t k = at; k < at + length && k < size; k++) data[k] = value;
    }
    return random_number() % 8 ? size : 1 + random_number() % size;
}

static void run_file(const char *folder, const char *name, unsigned long mutations) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "rb");
    if (!file) return;
    static uint8_t whole[1 << 20];
    size_t size = fread(whole, 1, sizeof whole, file);
    fclose(file);
    LLVMFuzzerTestOneInput(whole, size);
    uint8_t *copy = malloc(size + 1);
    for (unsigned long i = 0; copy && size && i < mutations; i++) {
        memcpy(copy, whole, size);
        size_t length = mutate(copy, size);
        uint8_t *exact = malloc(length); /* so that a sanitizer sees the first byte too many */
        if (!exact) abort();
        memcpy(exact, copy, length);
        LLVMFuzzerTestOneInput(exact, length);
        free(exact);
    }
    free(copy);
}

static int by_name(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    char *names[4096];
    size_t count = 0;
    DIR *dir = opendir(argv[1]);
    if (!dir) {
        fprintf(stderr, "replay: %s cannot be opened\n", argv[1]);
        return 1;
    }
    for (struct dirent *entry; (entry = readdir(dir)) && count < 4096;) {
        if (entry->d_name[0] != '.') names[count++] = strdup(entry->d_name);
    }
    closedir(dir);
    qsort(names, count, sizeof *names, by_name);
    unsigned long mutations = argc > 2 ? strtoul(argv[2], NULL, 10) : 0;
    for (size_t i = 0; i < count; i++) {
        run_file(argv[1], names[i], mutations);
        free(names[i]);
    }
    printf("%zu inputs with %lu mutations each\n", count, mutations);
    return count == 0;
}
