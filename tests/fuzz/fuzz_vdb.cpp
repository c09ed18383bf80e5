// Level sets of other programs. df_vdb_read tries each file in a process of its own, because OpenVDB trusts what a file
// says; starting it takes some hundred times as long as reading. So most inputs are tried by one process that goes on
// for as long as they leave it alive, and what it survives is read here; the others are read as programs do.
#include "convert/vdb.h"
#include "fuzz.h"

#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>

#include <pthread.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <new>

extern "C" {
void __attribute__((weak)) __asan_poison_memory_region(const volatile void *, std::size_t);
void __attribute__((weak)) __asan_unpoison_memory_region(const volatile void *, std::size_t);
void __attribute__((weak)) __sanitizer_set_death_callback(void (*callback)());
const char *__asan_default_options();
const char *__asan_default_options() { return "quarantine_size_mb=8"; }
const char *__lsan_default_suppressions();
const char *__lsan_default_suppressions() { return "leak:readTopology\n"; } // leaves and tiles of what OpenVDB forgets
}

// ---- memory

#ifdef FUZZ_AS_PROGRAMS // the thread sanitizer's operators cannot be replaced: each file has a process that limits
                        // itself
static constexpr unsigned as_programs_every = 1;
static void begin_file() {}
static void end_file() {}
#else
static constexpr unsigned as_programs_every = 1024;

// While a file is read, operator new gives 2 MB at once: a damaged length asks for gigabytes, whose shadow a sanitizer
// would write. And it knows the nodes of a tree: OpenVDB 10 forgets one whose children it cannot read; and from malloc,
// their pages would be new ones each time, which is half of what reading costs.
static constexpr std::size_t most_for_a_file = std::size_t(2) << 20;
static std::size_t most = SIZE_MAX;
using upper_node = openvdb::FloatTree::RootNodeType::ChildNodeType;
static constexpr std::size_t node_sizes[] = {sizeof(upper_node), sizeof(upper_node::ChildNodeType)};

struct node_list {
    void *blocks[256];
    unsigned count;
};
static node_list held[2], spare[2]; // by size

static bool put(node_list &list, void *block) {
    if (list.count == std::size(list.blocks)) return false;
    list.blocks[list.count++] = block;
    return true;
}

static void *allocate(std::size_t size) {
    if (size > most) return nullptr;
    for (unsigned kind = 0; most == most_for_a_file && kind < 2; kind++) {
        if (size != node_sizes[kind]) continue;
        void *block = spare[kind].count > 0 ? spare[kind].blocks[--spare[kind].count] : std::malloc(size);
        if (block && __asan_unpoison_memory_region) __asan_unpoison_memory_region(block, size);
        if (block) put(held[kind], block);
        return block;
    }
    return std::malloc(size ? size : 1);
}

static void free_node(unsigned kind, void *block) {
    if (!put(spare[kind], block)) std::free(block);
    else if (__asan_poison_memory_region) __asan_poison_memory_region(block, node_sizes[kind]);
}

static void release(void *block) {
    for (unsigned kind = 0; kind < 2; kind++) {
        node_list &list = held[kind];
        for (unsigned i = list.count; i-- > 0;) {
            if (list.blocks[i] != block) continue;
            list.blocks[i] = list.blocks[--list.count];
            return free_node(kind, block);
        }
    }
    std::free(block);
}

static void begin_file() { most = most_for_a_file; }

static void end_file() {
    most = SIZE_MAX;
    for (unsigned kind = 0; kind < 2; kind++) {
        while (held[kind].count > 0) free_node(kind, held[kind].blocks[--held[kind].count]);
    }
}

static void *allocate_or_throw(std::size_t size) {
    void *memory = allocate(size);
    if (!memory) throw std::bad_alloc();
    return memory;
}
void *operator new(std::size_t size) { return allocate_or_throw(size); }
void *operator new[](std::size_t size) { return allocate_or_throw(size); }
void *operator new(std::size_t size, const std::nothrow_t &) noexcept { return allocate(size); }
void *operator new[](std::size_t size, const std::nothrow_t &) noexcept { return allocate(size); }
void operator delete(void *memory) noexcept { release(memory); }
void operator delete[](void *memory) noexcept { release(memory); }
void operator delete(void *memory, std::size_t) noexcept { release(memory); }
void operator delete[](void *memory, std::size_t) noexcept { release(memory); }
#endif

// ---- processes that try files

// What ends one is no finding: that is what it is for. It ends without a report, which would take a hundred times as
// long as all else.
static volatile std::sig_atomic_t is_child;
extern "C" void __asan_on_error();
void __asan_on_error() {
    if (is_child) _exit(1);
}

static void forget_the_fuzzer() {
    is_child = 1;
    for (int signal : {SIGABRT, SIGALRM, SIGBUS, SIGFPE, SIGILL, SIGSEGV}) std::signal(signal, SIG_DFL);
    if (__sanitizer_set_death_callback) __sanitizer_set_death_callback(nullptr);
}

namespace {

int file;              // in memory: the input
char path[64];         // that file, in this process and in those it starts
int ask[2], answer[2]; // pipes: a byte for each file, and one for each that says whether it was survived

constexpr int no_more = 7; // exit: nobody asks

// Tries files, as the first process of df_vdb_read does, until one ends it, or so many that what OpenVDB forgets adds
// up.
[[noreturn]] void try_files() {
    char byte = 1;
    for (int i = 0; i < 10000; i++) {
        if (read(ask[0], &byte, 1) != 1) _exit(no_more);
        begin_file();
        try {
            std::ifstream stream(path, std::ios::binary);
            stream.exceptions(std::ios::badbit | std::ios::failbit | std::ios::eofbit);
            openvdb::io::Stream(stream, false).getGrids();
        } catch (...) { // refused, and alive
        }
        end_file();
        if (write(answer[1], &byte, 1) != 1) _exit(no_more);
    }
    _exit(0);
}

// Starts a process that tries files, and the next when it ends. This process is small still, and so are they.
[[noreturn]] void keep_trying() {
    close(ask[1]);
    close(answer[0]);
    std::signal(SIGINT, SIG_IGN); // it ends with the fuzzer
    if (!std::freopen("/dev/null", "w", stderr) || !std::freopen("/dev/null", "w", stdout)) _exit(1);
    for (int state;;) {
        const pid_t process = fork();
        if (process < 0) _exit(1);
        if (process == 0) try_files();
        while (waitpid(process, &state, 0) < 0 && errno == EINTR) {
        }
        if (WIFEXITED(state) && WEXITSTATUS(state) == no_more) _exit(0);
        const char died = 0;
        if (state != 0 && write(answer[1], &died, 1) != 1) _exit(0);
    }
}

bool prepare() {
    file = memfd_create("input.vdb", 0);
    std::snprintf(path, sizeof path, "/proc/self/fd/%d", file);
    openvdb::initialize();
    if (file < 0 || pthread_atfork(nullptr, nullptr, forget_the_fuzzer) != 0 || pipe(ask) != 0 || pipe(answer) != 0)
        return false;
    const pid_t keeper = fork();
    if (keeper == 0) keep_trying();
    close(ask[0]);
    close(answer[1]);
    return keeper > 0;
}

bool survives() {
    char byte = 1;
    ssize_t count = write(ask[1], &byte, 1);
    while (count == 1 && (count = read(answer[0], &byte, 1)) < 0 && errno == EINTR) count = 1; // the fuzzer's alarm
    if (count != 1) std::abort();
    return byte;
}

} // namespace

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const bool ready = prepare();
    static unsigned count;
    if (!ready || ftruncate(file, 0) != 0 || pwrite(file, data, size, 0) != ssize_t(size)) std::abort();
    const bool as_programs = count++ % as_programs_every == 0;
    if (!as_programs && !survives()) return 0;
    df_vdb *vdb = nullptr;
    df_vdb_info info;
    df_error err = {};
    begin_file();
    const df_status status = (as_programs ? df_vdb_read : df_vdb_read_trusted)(path, nullptr, 8, &vdb, &info, &err);
    if (status != DF_OK && !err.text[0]) std::abort(); // refused without a reason
    if (vdb) df_vdb_free(vdb);
    end_file();
    return 0;
}
