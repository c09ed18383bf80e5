// What an exception that nobody catches does in df-convert. OpenVDB's logging starts threads before main begins, and
// throws where memory or processes are short for them: that is to be one line and exit code 1, not a crash report.
#include <unistd.h>

#include <cstdio>
#include <exception>

namespace {

[[noreturn]] void end_with_a_line() {
    const char *hint = "is memory or the number of processes limited?";
    try {
        if (std::current_exception()) std::rethrow_exception(std::current_exception());
        std::fprintf(stderr, "df-convert: a library gave up (%s)\n", hint);
    } catch (const std::exception &e) {
        std::fprintf(stderr, "df-convert: a library gave up: %s (%s)\n", e.what(), hint);
    } catch (...) {
        std::fprintf(stderr, "df-convert: a library gave up (%s)\n", hint);
    }
    _exit(1);
}

void install() { std::set_terminate(end_with_a_line); }

// Runs before the constructors of the libraries.
[[gnu::section(".preinit_array"), gnu::used]] void (*const before_libraries)() = install;

} // namespace
