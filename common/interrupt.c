#include "common/interrupt.h"

#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static const char *program_name = "distfield";
static _Atomic(const char *) temporary_path;
static char mapping_message[512];

static void write_text(const char *text) {
    ssize_t ignored = write(STDERR_FILENO, text, strlen(text));
    (void)ignored;
}

/* One thread ends the process and speaks: those that render a mapped file meet its end together. */
static void begin_end(void) {
    static atomic_flag ending = ATOMIC_FLAG_INIT;
    while (atomic_flag_test_and_set(&ending)) pause();
}

/* Handlers are not interrupted by each other. */
static void install(int signal_number, void (*handler)(int)) {
    struct sigaction action = {.sa_handler = handler};
    sigfillset(&action.sa_mask);
    sigaction(signal_number, &action, NULL);
}

static void on_interrupt(int signal_number) {
    begin_end();
    const char *path = atomic_load(&temporary_path);
    if (path) unlink(path);
    write_text(program_name);
    write_text(signal_number == SIGINT ? ": interrupted\n" : ": terminated\n");
    _exit(128 + signal_number);
}

static void on_bus_error(int signal_number) {
    (void)signal_number;
    begin_end();
    const char *path = atomic_load(&temporary_path);
    if (path) unlink(path);
    write_text(mapping_message);
    _exit(1);
}

void df_interrupt_install(const char *program) {
    program_name = program;
    install(SIGINT, on_interrupt);
    install(SIGTERM, on_interrupt);
    signal(SIGXFSZ, SIG_IGN);
}

void df_interrupt_set_temporary(const char *path) { atomic_store(&temporary_path, path); }

void df_interrupt_guard_mapping(const char *path) {
    snprintf(mapping_message, sizeof mapping_message, "%s: %.400s: the file changed while it was in use\n",
             program_name, path);
    install(SIGBUS, on_bus_error);
}
