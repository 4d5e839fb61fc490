// Enough of CUDA C++ for one kernel to run as ordinary C++: a block's threads are real threads
// that meet at a barrier where the groups of a warp do. Nothing here is quick.
#include <math.h>

#include <atomic>
#include <barrier>
#include <cstdint>
#include <memory>
#include <cstring>
#include <thread>
#include <vector>

#define __global__
#define __device__
#define __constant__ const
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __grid_constant__

struct Index {
  unsigned x;
};
static thread_local Index threadIdx;

struct Group {
  explicit Group(int size) : gate(size), words(size) {}
  std::barrier<> gate;
  std::vector<uint64_t> words;
};
static thread_local Group *my_group;
static thread_local void *my_memory;
#define POOL_MEMORY REAL *const memory = (REAL *)my_memory;

static void __syncwarp(unsigned) { my_group->gate.arrive_and_wait(); }
template <class T, class F> static auto exchange(T value, F read) {
  auto &words = my_group->words;
  const int lane = threadIdx.x % words.size();
  uint64_t word = 0;
  memcpy(&word, &value, sizeof value);
  words[lane] = word;
  __syncwarp(0);
  const auto found = read(words, lane);
  __syncwarp(0);
  return found;
}
template <class T> static T as(uint64_t word) {
  T value;
  memcpy(&value, &word, sizeof value);
  return value;
}
template <class T> static T __shfl_sync(unsigned, T value, int from, int) {
  return exchange(value, [&](auto &words, int) { return as<T>(words[from]); });
}
template <class T> static T __shfl_xor_sync(unsigned, T value, int far) {
  return exchange(value, [&](auto &words, int lane) { return as<T>(words[lane ^ far]); });
}
static unsigned __reduce_or_sync(unsigned, unsigned value) {
  return exchange(value, [](auto &words, int) {
    unsigned all = 0;
    for (auto word : words) all |= (unsigned)word;
    return all;
  });
}
static unsigned long long atomicAdd(unsigned long long *to, unsigned long long by) {
  return std::atomic_ref<unsigned long long>(*to).fetch_add(by);
}
static unsigned __umulhi(unsigned a, unsigned b) { return (unsigned)(((uint64_t)a * b) >> 32); }
static int __popc(unsigned bits) { return __builtin_popcount(bits); }
static int __popcll(unsigned long long bits) { return __builtin_popcountll(bits); }
static float __fdividef(float a, float b) { return a / b; }
#define __log2f log2f
#define __sincosf sincosf
