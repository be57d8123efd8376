// A pool of threads that runs the items of one job at a time.
#pragma once
#include <cstdint>
#include <functional>

namespace recast {

int thread_count();
void set_thread_count(int n);

// Runs item(i) for i in 0 .. count - 1 on all threads and waits. Items are handed out in order but may
// run in any; results must not depend on which thread ran them. Another caller that finds the pool
// busy runs its items itself.
void parallel_for(int64_t count, const std::function<void(int64_t)>& item);

}  // namespace recast
