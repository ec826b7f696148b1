// SPDX-License-Identifier: MIT
#pragma once

#include <eigencast/eigencast.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <string>

#include "common/asset/asset.h"
#include "common/asset/format/encode.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/surface/surface.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"

/// What the functions of the C interface share.

struct ec_asset {
  std::shared_ptr<const eigencast::Asset> asset;
  std::shared_ptr<const eigencast::EncodedAsset> encoded;
  bool from_cache = false;
  bool loose_faces = false;  ///< Baked of a triangle soup.
};

namespace eigencast::abi {

/// What has threads lives where it was made: a forked process has of them no more than the memory, and leaves that.
class OfProcess {
 public:
  bool is_here() const { return ::getpid() == process_; }

 private:
  pid_t process_ = ::getpid();
};
/// The destruction of an object that has an OfProcess `home`; null is allowed.
template <typename Object>
void release_at_home(Object* object) {
  if (object != nullptr && object->home.is_here()) delete object;
}

/// Keeps the words for ec_last_error() on this thread.
ec_status failed(const Error& error);
ec_status invalid(const char* text);

/// Without appearance, samples and progress. Errors: kInvalidArgument.
Result<BakeOptions> bake_options_from(const ec_bake_options& given);
/// Without a URL. Errors: kInvalidArgument.
Result<PublisherOptions> publisher_options_from(const ec_publisher_options& given);

/// positions: vertices x 3; faces: face_count x 3, which may be null where there are none. Errors: kInvalidArgument.
Result<Surface> surface_from(const double* positions, std::uint32_t vertices, const std::uint32_t* faces,
                             std::uint32_t face_count);

/// Runs `body`, which returns an ec_status; no exception gets out.
template <typename Body>
ec_status guarded(Body&& body) {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return failed(fail(ErrorCode::kTooLarge, "out of memory"));
  } catch (const std::exception& error) {
    return failed(fail(ErrorCode::kInternal, error.what()));
  } catch (...) {
    return failed(fail(ErrorCode::kInternal, "unknown exception"));
  }
}

template <typename Options>
bool lacks_size(const Options* given) {
  return given != nullptr && given->struct_size < sizeof(std::size_t);
}

/// The caller's struct with our defaults where it is absent or was built against an older, shorter one.
template <typename Options>
Options filled(const Options* given) {
  Options options = EC_INIT(Options);
  if (given != nullptr) std::memcpy(&options, given, std::min(given->struct_size, sizeof options));
  return options;
}

template <typename Struct>
ec_status give(Struct* to, Struct from) {
  if (to == nullptr || to->struct_size < sizeof(std::size_t))
    return invalid("the result struct is null or its struct_size is not set");
  const std::size_t size = std::min(to->struct_size, sizeof from);
  from.struct_size = to->struct_size;
  std::memcpy(to, &from, size);
  return EC_OK;
}

template <typename Options>
Credentials credentials_from(const Options& given) {
  const auto text = [](const char* value) { return std::string(value != nullptr ? value : ""); };
  return {text(given.token), text(given.ca_file), text(given.certificate_file), text(given.key_file),
          given.insecure != 0};
}

inline std::string text_or(const char* text, std::string fallback) {
  return text != nullptr ? text : std::move(fallback);
}

}  // namespace eigencast::abi
