// The wall between C and the C++ libraries: whatever is thrown inside becomes a status with the library's text.
#ifndef DF_EXCEPTION_WALL_HPP
#define DF_EXCEPTION_WALL_HPP

#include "common/status.h"

#include <exception>
#include <new>

namespace df {

template <typename Body>
df_status guard(const char *name, df_status otherwise, df_error *err, Body body) {
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
