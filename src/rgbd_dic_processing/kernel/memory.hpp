// Memory for images and for what is made of them.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <new>
#include <utility>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace rgbd_dic {

// Hands out memory as vectors want it. Much of it comes in huge pages, if the system has some, and is kept
// for what asks for as much next, as image comes after image: to be given a new one page by page takes as
// long as to filter it.
class Memory {
 public:
  static void* take(std::size_t bytes) {
    if (bytes < kHugePage) return std::aligned_alloc(kLine, rounded(bytes, kLine));
    bytes = rounded(bytes, kHugePage);
    Memory& kept = instance();
    const std::lock_guard<std::mutex> lock(kept.mutex_);
    for (Block& block : kept.blocks_)
      if (block.bytes == bytes) {
        block.bytes = 0;
        return std::exchange(block.memory, nullptr);
      }
    void* memory = std::aligned_alloc(kHugePage, bytes);
#if defined(__linux__)
    if (memory) madvise(memory, bytes, MADV_HUGEPAGE);
#endif
    return memory;
  }

  static void give(void* memory, std::size_t bytes) {
    if (bytes >= kHugePage) {
      Memory& kept = instance();
      const std::lock_guard<std::mutex> lock(kept.mutex_);
      Block& oldest = kept.blocks_[kept.next_++ % kBlocksKept];
      std::swap(memory, oldest.memory);
      oldest.bytes = rounded(bytes, kHugePage);
    }
    std::free(memory);
  }

 private:
  static constexpr std::size_t kLine = 64, kHugePage = std::size_t{1} << 21,
                               kBlocksKept = 8;  // those of a reference and a target
  struct Block {
    void* memory = nullptr;
    std::size_t bytes = 0;
  };

  static Memory& instance() {
    static Memory& memory = *new Memory;  // outlives whatever gives something back
    return memory;
  }
  static std::size_t rounded(std::size_t bytes, std::size_t to) { return (bytes + to - 1) / to * to; }

  std::mutex mutex_;
  Block blocks_[kBlocksKept];
  std::size_t next_ = 0;
};

// Floats in such memory, not set.
class FloatBuffer {
 public:
  FloatBuffer() : values_(nullptr, Give{0}) {}
  explicit FloatBuffer(std::size_t count)
      : values_(static_cast<float*>(Memory::take(count * sizeof(float))), Give{count * sizeof(float)}) {
    if (!values_) throw std::bad_alloc();
  }
  float* data() { return values_.get(); }
  const float* data() const { return values_.get(); }

 private:
  struct Give {
    std::size_t bytes;
    void operator()(float* values) const { Memory::give(values, bytes); }
  };
  std::unique_ptr<float, Give> values_;
};

// A container's elements in such memory.
template <class Value>
struct Allocator {
  using value_type = Value;
  Allocator() = default;
  template <class Other>
  Allocator(const Allocator<Other>&) {}
  Value* allocate(std::size_t count) {
    void* memory = Memory::take(count * sizeof(Value));
    if (!memory) throw std::bad_alloc();
    return static_cast<Value*>(memory);
  }
  void deallocate(Value* values, std::size_t count) { Memory::give(values, count * sizeof(Value)); }
  friend bool operator==(const Allocator&, const Allocator&) { return true; }
  friend bool operator!=(const Allocator&, const Allocator&) { return false; }
};

}  // namespace rgbd_dic
