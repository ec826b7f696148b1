// SPDX-License-Identifier: MIT
#include "view/texture_image.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <new>
#include <string>
#include <thread>
#include <utility>

#include "common/core/memory_budget.h"

namespace eigencast {
namespace {

bool starts_with(const Bytes& bytes, std::initializer_list<std::uint8_t> magic) {
  return bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), bytes.begin());
}

constexpr const char* kTextureName = "the surface's texture";

// While it is decoded: three bytes a pixel and, of a progressive JPEG, six of coefficients; what is kept: three, and
// their mipmaps on the GPU.
constexpr std::uint64_t kDecodingBytes = 9, kPixelBytes = 7;

Result<Picture> decoded(const Bytes& bytes, int max_side) {
  const std::string name = kTextureName;
  const auto max_pixels = std::min<std::uint64_t>(kMaxPixels, received_memory().remaining() / kDecodingBytes);
  auto picture = starts_with(bytes, {0x89, 'P', 'N', 'G'}) ? read_png_bytes(bytes, name, max_pixels)
                 : starts_with(bytes, {0xff, 0xd8, 0xff})
                     ? read_jpeg_bytes(bytes, name, max_pixels)
                     : Result<Picture>(fail(ErrorCode::kUnsupported, name + " is neither PNG nor JPEG"));
  const int longest = std::clamp(max_side, 1, kMaxTextureSide);
  while (picture && std::max(picture->width, picture->height) > longest) {
    if (std::min(picture->width, picture->height) < 2)
      return fail(ErrorCode::kTooLarge, name + " is a line of over " + std::to_string(longest) + " pixels");
    *picture = halved(*picture);
  }
  return picture;
}

/// Does not throw: an exception would end the decoding thread, and callers would wait forever.
Result<Picture> decoded_or_error(const Bytes& bytes, int max_side) {
  try {
    return decoded(bytes, max_side);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, std::string(kTextureName) + " takes more memory than there is");
  }
}

class Decoder {
 public:
  ~Decoder() {
    {
      const std::lock_guard lock(mutex_);
      ends_ = true;
    }
    news_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

  TextureImage ask(const std::shared_ptr<const AssetTexture>& texture, Decode decode, int max_side) {
    std::unique_lock lock(mutex_);
    std::erase_if(known_, [](const auto& entry) { return entry.second.texture.expired(); });
    Known& mine = known_[texture.get()];
    mine.texture = texture;
    if (decode == Decode::kNow) news_.wait(lock, [&] { return !mine.queued; });
    if (mine.failed) return {nullptr, mine.failed};
    auto picture = mine.fresh ? std::exchange(mine.fresh, nullptr) : mine.picture.lock();
    if (picture || mine.queued) return {std::move(picture), {}};
    if (decode == Decode::kNow) {
      mine.queued = true;
      lock.unlock();
      auto result = decoded_or_error(texture->image, max_side);
      lock.lock();
      keep(*texture, std::move(result));
      return {std::exchange(mine.fresh, nullptr), mine.failed};
    }
    if (jobs_.size() >= kMaxImagesWaiting) return {};
    mine.queued = true;
    jobs_.push_back({texture, max_side});
    if (!thread_.joinable()) thread_ = std::thread([this] { work(); });
    news_.notify_all();
    return {};
  }

 private:
  struct Known {
    std::weak_ptr<const AssetTexture> texture;
    std::weak_ptr<const Picture> picture;
    std::shared_ptr<const Picture> fresh;  ///< Until the first caller takes it.
    std::optional<Error> failed;
    bool queued = false;  ///< Or being decoded.
  };
  struct Job {
    std::shared_ptr<const AssetTexture> texture;
    int max_side;
  };

  void work() {
    std::unique_lock lock(mutex_);
    for (;;) {
      news_.wait(lock, [this] { return ends_ || !jobs_.empty(); });
      if (ends_) return;
      const Job job = std::move(jobs_.front());
      jobs_.pop_front();
      lock.unlock();
      auto result = decoded_or_error(job.texture->image, job.max_side);
      lock.lock();
      keep(*job.texture, std::move(result));
    }
  }

  /// REQUIRES: the caller holds the texture.
  void keep(const AssetTexture& texture, Result<Picture> result) {
    Known& mine = known_[&texture];
    auto memory = result ? received_memory().take(kPixelBytes * (result->rgb.size() / 3), kTextureName)
                         : Result<MemoryBudget::Share>(result.error());
    if (memory) {
      struct Kept {
        Picture picture;
        MemoryBudget::Share memory;
      };
      const auto kept = std::make_shared<const Kept>(Kept{std::move(*result), std::move(*memory)});
      mine.fresh = std::shared_ptr<const Picture>(kept, &kept->picture);
      mine.picture = mine.fresh;
    } else {
      mine.failed = memory.error();
    }
    mine.queued = false;
    news_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable news_;  ///< For the thread and for waiting callers.
  std::map<const AssetTexture*, Known> known_;
  std::deque<Job> jobs_;
  std::thread thread_;
  bool ends_ = false;
};

}  // namespace

TextureImage image_of(const std::shared_ptr<const AssetTexture>& texture, Decode decode, int max_side) {
  static Decoder decoder;
  return decoder.ask(texture, decode, max_side);
}

Picture halved(const Picture& picture) {
  assert(picture.width > 1 && picture.height > 1);
  // The rounded square root of each mean of four squares.
  static const std::array<std::uint8_t, 65'026> root = [] {
    std::array<std::uint8_t, 65'026> of{};
    for (std::size_t i = 0; i < of.size(); ++i)
      of[i] = static_cast<std::uint8_t>(std::lround(std::sqrt(static_cast<double>(i))));
    return of;
  }();
  Picture half{picture.width / 2, picture.height / 2, {}, {}};
  half.rgb.reserve(std::size_t{3} * static_cast<std::size_t>(half.width) * static_cast<std::size_t>(half.height));
  for (int y = 0; y < half.height; ++y) {
    for (int x = 0; x < half.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        std::uint32_t sum = 0;
        for (const auto& [dx, dy] : {std::pair(0, 0), std::pair(1, 0), std::pair(0, 1), std::pair(1, 1)}) {
          const std::uint32_t value = picture.pixel(2 * x + dx, 2 * y + dy)[c];
          sum += value * value;
        }
        half.rgb.push_back(root[sum / 4]);
      }
    }
  }
  return half;
}

}  // namespace eigencast
