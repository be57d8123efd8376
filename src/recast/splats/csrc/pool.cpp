#include "pool.hpp"

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#if !defined(_WIN32)
#include <unistd.h>
#endif

namespace recast {
namespace {

long process_id() {
#if defined(_WIN32)
  return 0;
#else
  return long(getpid());
#endif
}

class Pool {
 public:
  explicit Pool(int threads) : threads_(threads), owner_(process_id()) {
    for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
  }

  ~Pool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      quit_ = true;
    }
    wake_.notify_all();
    for (std::thread& t : workers_) t.join();
  }

  int threads() const { return threads_; }
  // After a fork the workers are gone: such a pool must be left alone, not joined.
  bool belongs_here() const { return owner_ == process_id(); }

  void run(int64_t count, const std::function<void(int64_t)>& item) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      item_ = &item;
      count_ = count;
      next_.store(0, std::memory_order_relaxed);
      running_ = int(workers_.size());
      ++job_;
    }
    wake_.notify_all();
    drain();
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return running_ == 0; });
  }

 private:
  void drain() {
    for (int64_t i; (i = next_.fetch_add(1, std::memory_order_relaxed)) < count_;) (*item_)(i);
  }

  void work() {
    uint64_t seen = 0;
    for (;;) {
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return quit_ || job_ != seen; });
        if (quit_) return;
        seen = job_;
      }
      drain();
      std::lock_guard<std::mutex> lock(mutex_);
      if (--running_ == 0) done_.notify_one();
    }
  }

  const int threads_;
  const long owner_;
  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  const std::function<void(int64_t)>* item_ = nullptr;
  int64_t count_ = 0;
  std::atomic<int64_t> next_{0};
  int running_ = 0;
  uint64_t job_ = 0;
  bool quit_ = false;
};

std::mutex use;           // held while a job runs
Pool* pool = nullptr;     // never destroyed: threads must not be joined while the process exits
std::atomic<int> wanted{0};

}  // namespace

int thread_count() {
  int n = wanted.load();
  if (n > 0) return n;
  n = int(std::thread::hardware_concurrency());
  return n > 0 ? n : 1;
}

void set_thread_count(int n) { wanted.store(n < 1 ? 1 : n); }

void parallel_for(int64_t count, const std::function<void(int64_t)>& item) {
  const int threads = thread_count();
  std::unique_lock<std::mutex> lock(use, std::defer_lock);
  if (threads > 1 && count > 1 && lock.try_lock()) {
    if (pool && !pool->belongs_here()) pool = nullptr;
    if (pool && pool->threads() != threads) {
      delete pool;
      pool = nullptr;
    }
    if (!pool) pool = new Pool(threads);
    pool->run(count, item);
    return;
  }
  for (int64_t i = 0; i < count; ++i) item(i);
}

}  // namespace recast
