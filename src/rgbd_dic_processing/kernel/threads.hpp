// A loop over independent items on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__unix__)
#include <pthread.h>
#endif

namespace rgbd_dic {

constexpr int kMaxThreads = 1024;

// Number of threads to use for a request of `threads`, where 0 means every core the process may use.
inline int resolve_threads(int threads) {
  if (threads > 0) return threads;
  return static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

// Threads that wait for the next loop, as loop comes after loop: to start one takes as long as a hundred
// subsets.
class KeptThreads {
 public:
  static KeptThreads& instance() { return *of_process(); }

  // Calls work(0) on this thread and work(1) to work(workers - 1) on others, as far as they come before the
  // first is through: what is then left to do must be nothing. Returns when none is at work any more.
  void run(int workers, const std::function<void(int)>& work) {
    Loop loop{&work, workers};
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      have(workers - 1);
      loops_.push_back(&loop);
      ++posted_;
    }
    for (int worker = 1; worker < workers; ++worker) wake_.notify_one();
    work(0);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      loops_.erase(std::find(loops_.begin(), loops_.end(), &loop));
    }
    const auto through = [&] { return loop.at_work == 0; };
    spin(through);
    std::unique_lock<std::mutex> lock(mutex_);
    through_.wait(lock, through);
  }

 private:
  struct Loop {
    const std::function<void(int)>* work;
    int workers, next = 1;
    std::atomic<int> at_work{0};
  };

  static KeptThreads*& of_process() {
    static KeptThreads* kept = [] {
#if defined(__unix__)
      pthread_atfork(nullptr, nullptr, [] { of_process() = new KeptThreads; });  // a fork has none of them
#endif
      return new KeptThreads;  // outlives whatever waits
    }();
    return kept;
  }

  // Another loop mostly follows soon, and a core that sleeps takes long to wake.
  template <class Condition>
  static void spin(const Condition& met) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::microseconds(30);
    while (!met() && std::chrono::steady_clock::now() < end) std::this_thread::yield();
  }

  // Starts what lacks of `count` threads.
  void have(int count) {
    try {
      for (; threads_ < count; ++threads_) std::thread([this] { serve(); }).detach();
    } catch (const std::system_error&) {
      // No further thread to be had: the ones there are do all the work.
    }
  }

  void serve() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      const auto open = std::find_if(loops_.begin(), loops_.end(),
                                     [](const Loop* loop) { return loop->next < loop->workers; });
      if (open != loops_.end()) {
        Loop& loop = **open;
        const int worker = loop.next++;
        ++loop.at_work;
        lock.unlock();
        (*loop.work)(worker);
        lock.lock();
        if (--loop.at_work == 0) through_.notify_all();
        continue;
      }
      const auto posted = [this, seen = posted_.load()] { return posted_ != seen; };
      lock.unlock();
      spin(posted);
      lock.lock();
      wake_.wait(lock, posted);
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_, through_;
  std::vector<Loop*> loops_;
  std::atomic<unsigned> posted_{0};
  int threads_ = 0;
};

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
  workers == 1 ? run(0) : KeptThreads::instance().run(static_cast<int>(workers), run);
}

}  // namespace rgbd_dic
