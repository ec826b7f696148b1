// SPDX-License-Identifier: MIT
#pragma once

#include <cassert>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

namespace eigencast {

/// What went wrong, stable across releases. The message of an Error says what, where, why and what to do.
enum class ErrorCode {
  kInvalidArgument,      ///< The caller gave something that cannot be meant.
  kNotFound,             ///< A file, stream or asset that is not there.
  kCorrupt,              ///< Bytes that break their format.
  kTooLarge,             ///< Over a limit, which the message states.
  kUnsupported,          ///< Well-formed, but of a kind or version that this build does not handle.
  kIo,                   ///< The operating system refused a read, write or other call.
  kUnreachable,          ///< No connection could be made.
  kRefused,              ///< The peer said no (name taken, right missing).
  kDisconnected,         ///< The connection was there and is gone.
  kTimeout,              ///< A stated time ran out.
  kCancelled,            ///< The caller asked to stop.
  kIncompatibleVersion,  ///< The peer or file speaks another version.
  kNumerical,            ///< A computation did not converge or met a singular system.
  kInternal,             ///< A bug of Eigencast.
};

/// The code's name on the wire and in logs, for example "not-found".
constexpr std::string_view name_of(ErrorCode code) {
  constexpr std::string_view kNames[] = {
      "invalid-argument", "not-found",    "corrupt", "too-large", "unsupported",          "io",        "unreachable",
      "refused",          "disconnected", "timeout", "cancelled", "incompatible-version", "numerical", "internal"};
  return code <= ErrorCode::kInternal ? kNames[static_cast<int>(code)] : "unknown";
}

struct Error {
  ErrorCode code = ErrorCode::kInternal;
  std::string message;
};

/// A T or the Error that prevented it. Member names follow std::expected (C++23).
template <typename T>
class [[nodiscard]] Result {
 public:
  using value_type = T;
  Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}      // NOLINT: implicit on purpose
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}  // NOLINT: implicit on purpose

  bool has_value() const { return state_.index() == 0; }
  explicit operator bool() const { return has_value(); }

  /// REQUIRES: has_value()
  T& value() & {
    assert(has_value());
    return *std::get_if<0>(&state_);
  }
  const T& value() const& {
    assert(has_value());
    return *std::get_if<0>(&state_);
  }
  T&& value() && {
    assert(has_value());
    return std::move(*std::get_if<0>(&state_));
  }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }

  /// REQUIRES: !has_value()
  const Error& error() const {
    assert(!has_value());
    return *std::get_if<1>(&state_);
  }

 private:
  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  using value_type = void;
  Result() = default;
  Result(Error error) : error_(std::move(error)), ok_(false) {}  // NOLINT: implicit on purpose

  bool has_value() const { return ok_; }
  explicit operator bool() const { return ok_; }
  /// REQUIRES: !has_value()
  const Error& error() const {
    assert(!ok_);
    return error_;
  }

 private:
  Error error_;
  bool ok_ = true;
};

/// Makes an Error; converts to any Result<T>: `return fail(ErrorCode::kNotFound, "...")`.
inline Error fail(ErrorCode code, std::string message) {
  return Error{code, std::move(message)};
}

/// Moves a good result to where it is kept: `if (const auto good = store(member_, make()); !good) return good;`
template <typename T>
Result<void> store(T& target, Result<T> result) {
  if (!result) return result.error();
  target = std::move(*result);
  return {};
}

/// The same error with where it happened in front: "frame_0007.obj: vertex index 12 ...".
inline Error in_context(std::string_view where, Error error) {
  error.message = std::string(where) + ": " + error.message;
  return error;
}

}  // namespace eigencast
