// The wall between C and the C++ libraries: whatever is thrown inside becomes a status with the library's text.
#ifndef DF_EXCEPTION_WALL_HPP
#define DF_EXCEPTION_WALL_HPP

#include "common/status.h"

#include <gmp.h>

#include <cstdlib>
#include <exception>
#include <new>

namespace df {

// GMP, under CGAL's exact predicates, ends the process when memory is short, unless its allocation throws.
inline void *gmp_alloc(std::size_t size) {
    void *memory = std::malloc(size);
    if (!memory) throw std::bad_alloc();
    return memory;
}
inline void *gmp_realloc(void *memory, std::size_t, std::size_t size) {
    void *grown = std::realloc(memory, size);
    if (!grown) throw std::bad_alloc();
    return grown;
}
inline void gmp_free(void *memory, std::size_t) { std::free(memory); }
inline const bool gmp_throws = (mp_set_memory_functions(gmp_alloc, gmp_realloc, gmp_free), true);

template <typename Body> df_status guard(const char *name, df_status otherwise, df_error *err, Body body) {
    try {
        return body();
    } catch (const std::bad_alloc &) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", name);
    } catch (const std::exception &e) {
        return df_fail(err, otherwise, "%s: %s", name, e.what());
    } catch (...) {
        return df_fail(err, otherwise, "%s: unknown error", name);
    }
}

} // namespace df

#endif
