// Memory that grows and is kept from frame to frame.
#pragma once
#include <cstdint>
#include <cstdlib>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace recast {

class Memory {
 public:
  Memory() = default;
  Memory(const Memory&) = delete;
  Memory& operator=(const Memory&) = delete;
  ~Memory() { release(); }

  int64_t bytes() const { return capacity_; }

  // At least `bytes`, aligned to a cache line; what it held is lost when it grows.
  void* reserve(int64_t bytes) {
    if (bytes > capacity_) {
      release();
      // Some room to grow. Large buffers in huge pages: the sort and the bins jump all over them.
      const int64_t page = bytes < 2 * kHugePage ? 4096 : kHugePage;
      const int64_t wanted = (bytes + bytes / 8 + page - 1) / page * page;
#if defined(_WIN32)
      data_ = _aligned_malloc(size_t(wanted), size_t(page));
#else
      data_ = std::aligned_alloc(size_t(page), size_t(wanted));
#endif
#if defined(__linux__)
      if (data_ && page == kHugePage) madvise(data_, size_t(wanted), MADV_HUGEPAGE);
#endif
      if (!data_) throw std::bad_alloc();
      capacity_ = wanted;
    }
    return data_;
  }

 private:
  static constexpr int64_t kHugePage = 2 << 20;

  void release() {
#if defined(_WIN32)
    _aligned_free(data_);
#else
    std::free(data_);
#endif
    data_ = nullptr;
    capacity_ = 0;
  }

  void* data_ = nullptr;
  int64_t capacity_ = 0;
};

template <typename T>
class Buffer {
 public:
  T* reserve(int64_t count) { return static_cast<T*>(memory_.reserve(count * int64_t(sizeof(T)))); }
  int64_t bytes() const { return memory_.bytes(); }

 private:
  Memory memory_;
};

}  // namespace recast
