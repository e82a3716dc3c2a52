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

// Calls work(worker, begin, end) for consecutive blocks of [0, count) until none is left. `worker` is in
// [0, threads) and belongs to one thread at a time, so that it can index a workspace. Which thread takes
// which block is left to chance: work() must give the same result for an item whoever does it, and must not
// throw.
template <class Work>
void parallel_blocks(std::ptrdiff_t count, std::ptrdiff_t block, int threads, Work&& work) {
  std::atomic<std::ptrdiff_t> next{0};
  const auto run = [&](int worker) {
    for (;;) {
      const std::ptrdiff_t begin = next.fetch_add(block);
      if (begin >= count) return;
      work(worker, begin, std::min(begin + block, count));
    }
  };
  const std::ptrdiff_t blocks = (count + block - 1) / block;
  const int helpers = static_cast<int>(std::min<std::ptrdiff_t>(threads, blocks)) - 1;
  std::vector<std::thread> pool;
  pool.reserve(static_cast<std::size_t>(std::max(helpers, 0)));
  try {
    for (int worker = 1; worker <= helpers; ++worker) pool.emplace_back(run, worker);
  } catch (const std::system_error&) {
    // No further thread to be had: the ones there are take all blocks.
  }
  run(0);
  for (std::thread& thread : pool) thread.join();
}

}  // namespace rgbd_dic
