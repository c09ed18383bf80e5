// An input stream over bytes in memory, without a copy.
#ifndef DF_MEMORY_STREAM_HPP
#define DF_MEMORY_STREAM_HPP

#include <istream>
#include <streambuf>

namespace df {

class memory_buffer : public std::streambuf {
  public:
    memory_buffer(char *data, std::size_t size) { setg(data, data, data + size); }

  protected:
    pos_type seekoff(off_type offset, std::ios_base::seekdir way, std::ios_base::openmode) override {
        char *from = way == std::ios_base::beg ? eback() : way == std::ios_base::cur ? gptr() : egptr();
        if (offset < eback() - from || offset > egptr() - from) return pos_type(off_type(-1));
        setg(eback(), from + offset, egptr());
        return pos_type(gptr() - eback());
    }
    pos_type seekpos(pos_type position, std::ios_base::openmode mode) override {
        return seekoff(off_type(position), std::ios_base::beg, mode);
    }
};

} // namespace df

#endif
