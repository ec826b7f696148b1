// SPDX-License-Identifier: MIT
// Loaded before libc (LD_PRELOAD): the wall clock is so many seconds off as the 64-bit number at the start of the file
// $EIGENCAST_TEST_CLOCK says at the moment, also for waits until one of its times. The steady clock is left alone, as
// when an operator sets the time.
#include <fcntl.h>
#include <pthread.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>

namespace {

std::int64_t offset_s() {
  static const volatile std::int64_t* const offset = []() -> const volatile std::int64_t* {
    const char* path = std::getenv("EIGENCAST_TEST_CLOCK");
    const int fd = path != nullptr ? ::open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (fd < 0) std::abort();
    void* const page = ::mmap(nullptr, sizeof *offset, PROT_READ, MAP_SHARED, fd, 0);
    ::close(fd);
    if (page == MAP_FAILED) std::abort();
    return static_cast<const volatile std::int64_t*>(page);
  }
  ();
  return *offset;
}

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kLook = kSecond / 20;              ///< How often a wait looks at the clock.
constexpr std::int64_t kLongAgo = 500'000'000 * kSecond;  ///< Times before that are of the steady clock: 1985.

std::int64_t ns(const timespec& time) {
  return time.tv_sec * kSecond + time.tv_nsec;
}

}  // namespace

extern "C" {

int clock_gettime(clockid_t clock, timespec* out) noexcept {
  const auto result = static_cast<int>(::syscall(SYS_clock_gettime, clock, out));
  if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) out->tv_sec += offset_s();
  return result;
}

int gettimeofday(timeval* __restrict out, void* __restrict) noexcept {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  *out = {now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

int pthread_cond_timedwait(pthread_cond_t* __restrict condition, pthread_mutex_t* __restrict mutex,
                           const timespec* __restrict until) {
  if (ns(*until) < kLongAgo) return pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, until);
  for (;;) {
    timespec wall{}, steady{};
    clock_gettime(CLOCK_REALTIME, &wall);
    clock_gettime(CLOCK_MONOTONIC, &steady);
    if (ns(wall) >= ns(*until)) return ETIMEDOUT;
    const std::int64_t look = ns(steady) + std::min(ns(*until) - ns(wall), kLook);
    steady = {look / kSecond, look % kSecond};
    const int result = pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, &steady);
    if (result != ETIMEDOUT) return result;
  }
}

time_t time(time_t* out) noexcept {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  if (out != nullptr) *out = now.tv_sec;
  return now.tv_sec;
}
}
