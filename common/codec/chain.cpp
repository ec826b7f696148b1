// SPDX-License-Identifier: MIT
#include "common/codec/chain.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <functional>
#include <string>

#include "common/codec/band.h"
#include "common/codec/fixed.h"
#include "common/codec/pose_memory.h"

namespace eigencast {
namespace {

Error corrupt_payload(std::string what) {
  return fail(ErrorCode::kCorrupt, "payload: " + std::move(what));
}
Error codec_misuse(std::string what) {
  return fail(ErrorCode::kInvalidArgument, "codec: " + std::move(what));
}

bool fits(const CoefficientLayout& layout, const Key& key) {
  const std::size_t size = layout.is_float() ? key.f.size() : key.q.size();
  return layout.all_bands().includes(key.bands) && size == layout.size() && (!layout.is_float() || key.step == 0);
}

bool all_in_range(std::span<const std::int32_t> values) {
  bool all = true;  // No early return, so that the loop vectorises.
  for (const std::int32_t q : values) all &= (q >= -fixed::kMaxValue) & (q <= fixed::kMaxValue);
  return all;
}

/// Holds values at the frame's step, to reuse the memory.
struct RescaledValues {
  std::vector<std::int32_t> c1, c2, e, e1;
};

/// The band's values of a key of the state at `step`; empty where the key lacks the band or rescaling overflows.
std::span<const std::int32_t> reference(const CoefficientLayout& layout, const Key& key, std::size_t band,
                                        std::uint8_t step, std::vector<std::int32_t>& rescaled) {
  if (!key.bands.has(band) || key.q.size() != layout.size()) return {};
  const auto [first, last] = layout.range(band);
  const std::span held = std::span(key.q).subspan(first, last - first);
  if (key.step == step) return all_in_range(held) ? held : std::span<const std::int32_t>();
  rescaled.resize(held.size());
  const fixed::Rescale rule(key.step, step);
  for (std::size_t i = 0; i < held.size(); ++i) {
    const std::int64_t value = rule(held[i]);
    if (!fixed::in_range(value)) return {};
    rescaled[i] = static_cast<std::int32_t>(value);
  }
  return rescaled;
}

/// Valid until the state or the values change.
band::References references(const CoefficientLayout& layout, const ChainState& state, std::size_t band,
                            std::uint8_t step, RescaledValues& values) {
  band::References out;
  out.c1 = reference(layout, state.newer, band, step, values.c1);
  if (!out.c1.empty()) out.c2 = reference(layout, state.older, band, step, values.c2);
  return out;
}

/// Where a key is in a memory.
struct Recollection {
  const PoseMemory* memory;
  std::uint32_t phase;
};

/// Adds the memory's values of a band that is predicted at all; false if one leaves the range. REQUIRES: the memory has
/// both phases.
bool recall(const CoefficientLayout& layout, const ChainState& state, const Recollection& at, std::size_t band,
            std::uint8_t step, band::References& from, RescaledValues& values) {
  if (from.c1.empty()) return true;
  const auto [first, last] = layout.range(band);
  const auto recalled = [&, first = first, last = last](std::uint32_t phase, std::vector<std::int32_t>& out,
                                                        std::span<const std::int32_t>& where) {
    out.resize(last - first);
    where = out;
    return at.memory->recall(phase, step, first, out);
  };
  return recalled(at.phase, values.e, from.e) && (!state.phase || recalled(*state.phase, values.e1, from.e1));
}

Result<void> append_floats(const CoefficientLayout& layout, std::size_t band, const Key& key, Bytes& out) {
  const auto [first, last] = layout.range(band);
  ByteWriter writer(out);
  for (std::size_t i = first; i < last; ++i) {
    const bool narrow = layout.codec == CodecKind::kFloat32;
    if (!std::isfinite(narrow ? double{static_cast<float>(key.f[i])} : key.f[i])) {
      return fail(ErrorCode::kTooLarge,
                  "codec: value " + std::to_string(i) + " is not finite as " + std::string(name_of(layout.codec)));
    }
    if (narrow) {
      writer.f32(static_cast<float>(key.f[i]));
    } else {
      writer.f64(key.f[i]);
    }
  }
  return {};
}

/// Appends the run of a band of `key` and sets `key` to the decoded values.
Result<void> append_run(const CoefficientLayout& layout, std::size_t band, const band::References& from,
                        std::uint8_t half_spacing, Key& key, Bytes& out) {
  if (layout.is_float()) return append_floats(layout, band, key, out);
  const auto [first, last] = layout.range(band);
  const std::span<std::int32_t> values = std::span(key.q).subspan(first, last - first);
  if (!all_in_range(values)) {
    return fail(ErrorCode::kTooLarge, "codec: a value of band " + std::to_string(band) + " leaves +-2^30");
  }
  if (half_spacing > 0 && !from.c1.empty()) {
    std::vector<std::int32_t> decoded(values.size());
    if (band::append_coarse(values, from, {half_spacing, layout.channels}, out, decoded)) {
      std::copy(decoded.begin(), decoded.end(), values.begin());
      return {};
    }
  }
  if (half_spacing > 0) out.push_back(band::kExactFollows);
  band::append_exact(values, from.c1, out);
  return {};
}

/// Whether a band is further than `distance` steps from what it is predicted from.
bool differs(const CoefficientLayout& layout, std::size_t band, const Key& base, const Key& pose, unsigned distance) {
  const auto [first, last] = layout.range(band);
  for (std::size_t i = first; i < last; ++i) {
    if (layout.is_float() ? pose.f[i] != base.f[i] : std::abs(std::int64_t{pose.q[i]} - base.q[i]) > distance)
      return true;
  }
  return false;
}

/// Reads the run at the front of `in` into `key` and returns the bytes it took.
Result<std::size_t> read_run(const CoefficientLayout& layout, std::size_t band, const band::References& from,
                             std::uint8_t half_spacing, ByteView in, Key& key) {
  const auto [first, last] = layout.range(band);
  if (!layout.is_float())
    return band::read(in, from, {half_spacing, layout.channels}, std::span(key.q).subspan(first, last - first));
  ByteReader reader(in);
  for (std::size_t i = first; i < last; ++i) {
    key.f[i] = layout.codec == CodecKind::kFloat32 ? double{reader.f32()} : reader.f64();
    if (!std::isfinite(key.f[i])) return fail(ErrorCode::kCorrupt, "a value is not finite");
  }
  if (reader.failed()) return fail(ErrorCode::kCorrupt, "its values end early");
  return reader.position();
}

/// Reads a run that takes all of `in`.
Result<void> read_last_run(const CoefficientLayout& layout, std::size_t band, const band::References& from,
                           std::uint8_t half_spacing, ByteView in, Key& key) {
  const auto taken = read_run(layout, band, from, half_spacing, in, key);
  if (!taken) return taken.error();
  if (*taken != in.size()) return fail(ErrorCode::kCorrupt, "bytes are left over");
  return {};
}

constexpr unsigned kSameStep = 3;  ///< Codec number of quantised payloads at the step of the newer key.

struct Head {
  std::uint8_t half_spacing = 0;         ///< Keys and residuals only.
  std::optional<std::uint8_t> step;      ///< Absent (keys and residuals): that of the state's newer key.
  std::uint8_t older_step = 0;           ///< Joins only.
  BandMask older_bands;                  ///< Joins only.
  std::optional<std::uint64_t> phase{};  ///< With the memory's flag; in keys as the difference from the state's.
};

void append_head(const CoefficientLayout& layout, bool join, const Head& head, ByteWriter& writer) {
  const unsigned codec = head.step ? static_cast<unsigned>(layout.codec) : kSameStep;
  writer.u8(static_cast<std::uint8_t>(codec | unsigned{head.half_spacing} << 2));
  if (head.step) writer.u8(*head.step);
  if (join) writer.u8(head.older_step), writer.u8(head.older_bands.bits);
  if (head.phase) writer.varint(*head.phase);
}

Result<void> check_coded(const CoefficientLayout& layout, const Key& key, std::uint8_t half_spacing) {
  if (key.bands.empty() || !fits(layout, key)) return codec_misuse("the key does not fit the layout");
  if (half_spacing > band::kMaxHalfSpacing) return codec_misuse("a half spacing is 63 steps at most");
  return {};
}

void append_key_head(const CoefficientLayout& layout, const Key& newer, const Key& key, std::uint8_t half_spacing,
                     ByteWriter& writer, std::optional<std::uint64_t> phase = {}) {
  const std::uint8_t m = layout.is_float() ? std::uint8_t{0} : half_spacing;
  const bool same_step = !layout.is_float() && key.step == newer.step;
  append_head(layout, false, {m, same_step ? std::nullopt : std::optional(key.step), 0, 0, phase}, writer);
}

Result<Head> read_head(const CoefficientLayout& layout, bool join, bool recalled, BandMask bands, ByteReader& reader) {
  if (bands.empty() || !layout.all_bands().includes(bands))
    return corrupt_payload("bands that the stream does not have");
  Head head;
  const std::uint8_t first = reader.u8();
  const unsigned codec = first & 3u;
  head.half_spacing = first >> 2;
  const bool same_step = codec == kSameStep && !join && !layout.is_float();
  if (!same_step) head.step = reader.u8();
  if (join) {
    head.older_step = reader.u8();
    head.older_bands = reader.u8();
  }
  if (recalled) head.phase = reader.varint();
  if (reader.failed()) return corrupt_payload("it ends within its head");
  if (codec != static_cast<unsigned>(layout.codec) && !same_step) {
    return corrupt_payload("codec " + std::to_string(codec) + " where the stream has " +
                           std::string(name_of(layout.codec)));
  }
  if (layout.is_float() && (*head.step != 0 || head.older_step != 0))
    return corrupt_payload("a float codec has no step");
  if (recalled && (layout.is_float() || (!join && head.half_spacing == 0)))
    return corrupt_payload("it is exact and cannot come from a memory");
  if (head.half_spacing != 0 && (join || layout.is_float()))
    return corrupt_payload("it is exact and cannot have a spacing");
  if (!bands.includes(head.older_bands)) return corrupt_payload("the older key has bands that the newer lacks");
  return head;
}

/// Calls visit() with the section of each band. Errors: kCorrupt where bytes remain.
Result<void> each_section(const CoefficientLayout& layout, BandMask bands, ByteReader& reader,
                          const std::function<Result<void>(std::size_t band, ByteView section)>& visit) {
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    const std::uint64_t length = reader.varint();
    const ByteView section = reader.bytes(length);
    const std::string where = "payload: band " + std::to_string(band);
    if (reader.failed()) return fail(ErrorCode::kCorrupt, where + ": it ends early");
    if (const auto visited = visit(band, section); !visited) return in_context(where, visited.error());
  }
  if (!reader.finished()) return corrupt_payload(std::to_string(reader.remaining()) + " bytes are left over");
  return {};
}

/// Appends the section of each band, whose runs append(band, run) appends to the empty `run`.
template <typename Append>
Result<void> append_sections(const CoefficientLayout& layout, BandMask bands, Bytes& run, ByteWriter& writer,
                             const Append& append) {
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    run.clear();
    if (auto appended = append(band, run); !appended) return appended;
    writer.varint(run.size());
    writer.bytes(run);
  }
  return {};
}

/// encode_key, and with `at` encode_recalled_key.
Result<CodedKey> encode_key(const CoefficientLayout& layout, const ChainState& state, const Recollection* at,
                            const Key& key, std::uint8_t half_spacing) {
  if (const auto checked = check_coded(layout, key, half_spacing); !checked) return checked.error();
  CodedKey out{{}, key};
  ByteWriter writer(out.payload);
  std::optional<std::uint64_t> code;
  if (at != nullptr) code = zigzag(std::int64_t{at->phase} - state.phase.value_or(0)), out.phase = at->phase;
  append_key_head(layout, state.newer, key, half_spacing, writer, code);
  Bytes memory;
  RescaledValues rescaled;
  const auto appended =
      append_sections(layout, key.bands, memory, writer, [&](std::size_t band, Bytes& run) -> Result<void> {
        auto from = references(layout, state, band, key.step, rescaled);
        if (at != nullptr && !recall(layout, state, *at, band, key.step, from, rescaled))
          return fail(ErrorCode::kTooLarge, "codec: the memory leaves +-2^30 at the key's step");
        return append_run(layout, band, from, half_spacing, out.key, run);
      });
  if (!appended) return appended.error();
  return out;
}

/// decode_key, and with a memory decode_recalled_key.
Result<RecalledKey> read_key(const CoefficientLayout& layout, BandMask bands, const ChainState& state,
                             const PoseMemory* memory, ByteView payload) {
  ByteReader reader(payload);
  const auto head = read_head(layout, false, memory != nullptr, bands, reader);
  if (!head) return head.error();
  RecalledKey out{empty_key(layout, bands, head->step.value_or(state.newer.step)), 0};
  if (memory != nullptr) {
    const std::int64_t way = unzigzag(*head->phase), before = state.phase.value_or(0);
    if (way < -before || way > UINT32_MAX || !memory->has(static_cast<std::uint64_t>(before + way)) ||
        (state.phase && !memory->has(*state.phase)))
      return corrupt_payload("a phase that the memory does not have");
    out.phase = static_cast<std::uint32_t>(before + way);
  }
  RescaledValues values;
  const auto read = each_section(layout, bands, reader, [&](std::size_t band, ByteView section) -> Result<void> {
    auto from = references(layout, state, band, out.key.step, values);
    if (memory != nullptr && !recall(layout, state, {memory, out.phase}, band, out.key.step, from, values))
      return corrupt_payload("its memory leaves +-2^30");
    return read_last_run(layout, band, from, head->half_spacing, section, out.key);
  });
  if (!read) return read.error();
  return out;
}

}  // namespace

ChainState advanced(std::optional<ChainState> state, Key key, TimeUs age_us, std::optional<std::uint32_t> phase) {
  if (!state) return {key, key, 0};
  return {std::move(state->newer), std::move(key), age_us, phase};
}

Result<CodedKey> encode_key(const CoefficientLayout& layout, const ChainState& state, const Key& key,
                            std::uint8_t half_spacing) {
  return encode_key(layout, state, nullptr, key, half_spacing);
}

Result<CodedKey> encode_recalled_key(const CoefficientLayout& layout, const ChainState& state, const PoseMemory& memory,
                                     std::uint32_t phase, const Key& key, std::uint8_t half_spacing) {
  if (layout.is_float() || half_spacing == 0) return codec_misuse("what is exact cannot come from a memory");
  if (memory.layout() != layout || !memory.has(phase) || (state.phase && !memory.has(*state.phase)))
    return codec_misuse("the memory has no such phase");
  const Recollection at{&memory, phase};
  return encode_key(layout, state, &at, key, half_spacing);
}

Result<CodedResidual> encode_residual(const CoefficientLayout& layout, const Key& base, Key pose,
                                      std::uint8_t half_spacing) {
  if (const auto checked = check_coded(layout, pose, half_spacing); !checked) return checked.error();
  if (!fits(layout, base) || base.step != pose.step) return codec_misuse("the pose does not fit what it is made of");
  CodedResidual out;
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if ((base.bands & pose.bands).has(band) && differs(layout, band, base, pose, half_spacing))
      out.bands |= static_cast<std::uint8_t>(1u << band);
  }
  if (out.bands.empty()) return out;
  ByteWriter writer(out.payload);
  append_key_head(layout, base, pose, half_spacing, writer);
  Bytes memory;
  const auto appended = append_sections(layout, out.bands, memory, writer, [&](std::size_t band, Bytes& run) {
    if (layout.is_float()) return append_floats(layout, band, pose, run);
    const auto [first, last] = layout.range(band);
    const auto values = std::span(pose.q).subspan(first, last - first);
    const auto from = std::span(base.q).subspan(first, last - first);
    if (half_spacing > 0 && band::append_nearest(values, from, {half_spacing, layout.channels}, run))
      return Result<void>();
    if (half_spacing > 0) run.push_back(band::kExactFollows);
    return append_run(layout, band, {from, {}}, 0, pose, run);
  });
  if (!appended) return appended.error();
  return out;
}

Result<Key> decode_residual(const CoefficientLayout& layout, BandMask bands, Key base, ByteView payload) {
  if (!base.bands.includes(bands)) return corrupt_payload("a residual of a band that the pose lacks");
  ChainState state{{}, std::move(base), 0};
  const auto residual = decode_key(layout, bands, state, payload);
  if (!residual) return residual.error();
  Key& pose = state.newer;
  if (residual->step != pose.step) return corrupt_payload("a residual of another step than the pose");
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i) {
      if (layout.is_float()) pose.f[i] = residual->f[i];
      if (!layout.is_float()) pose.q[i] = residual->q[i];
    }
  }
  return std::move(pose);
}

std::uint8_t half_spacing_of(ByteView payload) {
  return payload.empty() ? std::uint8_t{0} : static_cast<std::uint8_t>(payload[0] >> 2);
}

Result<Key> decode_key(const CoefficientLayout& layout, BandMask bands, const ChainState& state, ByteView payload) {
  auto read = read_key(layout, bands, state, nullptr, payload);
  return read ? Result<Key>(std::move(read->key)) : read.error();
}

Result<RecalledKey> decode_recalled_key(const CoefficientLayout& layout, BandMask bands, const ChainState& state,
                                        const PoseMemory& memory, ByteView payload) {
  assert(memory.layout() == layout);
  return read_key(layout, bands, state, &memory, payload);
}

Result<Bytes> encode_join(const CoefficientLayout& layout, const ChainState& state) {
  if (state.newer.bands.empty() || !fits(layout, state.newer) || !fits(layout, state.older))
    return codec_misuse("the state does not fit the layout");
  // A band of the older key alone can be neither predicted from nor interpolated.
  const BandMask older_bands = state.older.bands & state.newer.bands;
  ChainState coded = state;
  Bytes out;
  ByteWriter writer(out);
  std::vector<std::int32_t> rescaled;
  append_head(layout, true, {0, state.newer.step, state.older.step, older_bands, state.phase}, writer);
  Bytes memory;
  const auto appended = append_sections(layout, state.newer.bands, memory, writer, [&](std::size_t band, Bytes& run) {
    band::References from;
    if (older_bands.has(band)) {
      if (auto older = append_run(layout, band, {}, 0, coded.older, run); !older) return older;
      from.c1 = reference(layout, state.older, band, state.newer.step, rescaled);
    }
    return append_run(layout, band, from, 0, coded.newer, run);
  });
  if (!appended) return appended.error();
  return out;
}

Result<ChainState> decode_join(const CoefficientLayout& layout, BandMask bands, ByteView payload, bool recalled) {
  ByteReader reader(payload);
  const auto head = read_head(layout, true, recalled, bands, reader);
  if (!head) return head.error();
  ChainState state{empty_key(layout, head->older_bands, head->older_step), empty_key(layout, bands, *head->step), 0};
  if (head->phase.value_or(0) > UINT32_MAX) return corrupt_payload("a phase that no memory has");
  if (recalled) state.phase = static_cast<std::uint32_t>(*head->phase);
  std::vector<std::int32_t> rescaled;
  const auto read = each_section(layout, bands, reader, [&](std::size_t band, ByteView section) -> Result<void> {
    band::References from;
    if (head->older_bands.has(band)) {
      const auto taken = read_run(layout, band, from, 0, section, state.older);
      if (!taken) return taken.error();
      section = section.subspan(*taken);
      from.c1 = reference(layout, state.older, band, state.newer.step, rescaled);
    }
    return read_last_run(layout, band, from, 0, section, state.newer);
  });
  if (!read) return read.error();
  return state;
}

Result<Bytes> cut_bands(const CoefficientLayout& layout, bool join, BandMask bands, BandMask keep, ByteView payload,
                        bool recalled) {
  ByteReader reader(payload);
  auto head = read_head(layout, join, recalled, bands, reader);
  if (!head) return head.error();
  if ((bands & keep).empty()) return codec_misuse("no band would be left");
  head->older_bands &= keep;
  Bytes out;
  ByteWriter writer(out);
  append_head(layout, join, *head, writer);
  const auto read = each_section(layout, bands, reader, [&](std::size_t band, ByteView section) -> Result<void> {
    if (!keep.has(band)) return {};
    writer.varint(section.size());
    writer.bytes(section);
    return {};
  });
  if (!read) return read.error();
  return out;
}

}  // namespace eigencast
