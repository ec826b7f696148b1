// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/execution/executor.hpp>
#include <boost/asio/query.hpp>
#include <boost/asio/require.hpp>
#include <mutex>
#include <type_traits>
#include <utility>

namespace eigencast {

/// Runs what it is given as Inner does, and holds a lock meanwhile: another thread that takes that lock may use what
/// belongs to the handlers. Meets Asio's requirements of an executor. The lock must outlive it, and is
/// recursive because a handler may be run within another.
template <typename Inner>
class LockingExecutor {
 public:
  LockingExecutor(Inner inner, std::recursive_mutex& lock) noexcept : inner_(std::move(inner)), lock_(&lock) {}

  template <typename Property>
  auto query(const Property& property) const -> decltype(boost::asio::query(std::declval<const Inner&>(), property)) {
    return boost::asio::query(inner_, property);
  }
  template <typename Property>
  auto require(const Property& property) const
      -> LockingExecutor<std::decay_t<decltype(boost::asio::require(std::declval<const Inner&>(), property))>> {
    return {boost::asio::require(inner_, property), *lock_};
  }
  template <typename Function>
  void execute(Function&& function) const {
    inner_.execute([lock = lock_, run = std::forward<Function>(function)]() mutable {
      const std::lock_guard held(*lock);
      run();
    });
  }
  friend bool operator==(const LockingExecutor& a, const LockingExecutor& b) noexcept {
    return a.inner_ == b.inner_ && a.lock_ == b.lock_;
  }
  friend bool operator!=(const LockingExecutor& a, const LockingExecutor& b) noexcept { return !(a == b); }

 private:
  Inner inner_;
  std::recursive_mutex* lock_;
};

}  // namespace eigencast
