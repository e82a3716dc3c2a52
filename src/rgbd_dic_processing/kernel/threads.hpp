// A loop over independent items on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <system_error>
#include <thread>
#include <vector>

namespace rgbd_dic {

constexpr int kMaxThreads = 1024;

// Number of threads to use for a request of `threads`, where 0 means every core the process may use.
inline int resolve_threads(int threads) {
  if (threads > 0) return threads;
  return static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

// Calls work(worker, begin, end) for blocks of [0, count) until none is left. `worker` is in [0, threads) and
// belongs to one thread at a time, so that it can index a workspace. Each thread goes through a part of its
// own, in order, as what lies beside each other shares what is in its cache; when it is through, it helps
// with the other parts. So which thread takes which block is left to chance: work() must give the same result
// for an item whoever does it, and must not throw.
template <class Work>
void parallel_blocks(std::ptrdiff_t count, std::ptrdiff_t block, int threads, Work&& work) {
  struct alignas(64) Part {  // a cache line of its own
    std::atomic<std::ptrdiff_t> next{0};
    std::ptrdiff_t end = 0;
  };
  const std::ptrdiff_t blocks = (count + block - 1) / block;
  const std::ptrdiff_t workers = std::max<std::ptrdiff_t>(std::min<std::ptrdiff_t>(threads, blocks), 1);
  std::vector<Part> parts(static_cast<std::size_t>(workers));
  for (std::ptrdiff_t k = 0; k < workers; ++k) {
    parts[k].next = blocks * k / workers * block;
    parts[k].end = std::min(blocks * (k + 1) / workers * block, count);
  }
  const auto run = [&](std::ptrdiff_t worker) {
    for (std::ptrdiff_t k = 0; k < workers; ++k) {
      Part& part = parts[(worker + k) % workers];
      for (;;) {
        const std::ptrdiff_t begin = part.next.fetch_add(block);
        if (begin >= part.end) break;
        work(static_cast<int>(worker), begin, std::min(begin + block, part.end));
      }
    }
  };
  std::vector<std::thread> pool;
  pool.reserve(static_cast<std::size_t>(workers - 1));
  try {
    for (std::ptrdiff_t worker = 1; worker < workers; ++worker) pool.emplace_back(run, worker);
  } catch (const std::system_error&) {
    // No further thread to be had: the ones there are take all blocks.
  }
  run(0);
  for (std::thread& thread : pool) thread.join();
}

}  // namespace rgbd_dic
