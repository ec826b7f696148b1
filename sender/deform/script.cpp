// SPDX-License-Identifier: MIT
#include "sender/deform/script.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>

namespace eigencast::deform {
namespace {

/// Between secants s0 and s1 over spans h0 and h1: zero at an extremum, else their weighted harmonic mean.
double slope(double s0, double s1, double h0, double h1) {
  if (s0 * s1 <= 0) return 0;
  return 3 * (h0 + h1) / ((2 * h1 + h0) / s0 + (h1 + 2 * h0) / s1);
}

Vec3 moved_by(const Move& move, const Box& box, const Vec3& p, std::size_t which, std::span<const double> values) {
  switch (move.kind) {
    case Move::Kind::kTwist:
      return twisted(p, box, move.frame, values[0]);
    case Move::Kind::kBend:
      return bent(p, box, move.frame, values[0]);
    case Move::Kind::kRotate:
      return turned(p, move.centre, move.frame.axis, values[0]);
    case Move::Kind::kTranslate:
      return {p[0] + values[0], p[1] + values[1], p[2] + values[2]};
    case Move::Kind::kScale:
      return scaled(p, move.centre, {values[0], values[1], values[2]});
    case Move::Kind::kPosition:
      return {values[3 * which], values[3 * which + 1], values[3 * which + 2]};
  }
  return p;
}

}  // namespace

std::vector<double> Track::at(double time_s) const {
  assert(!times.empty() && values.size() == times.size() * width);
  const auto row = [&](std::size_t key) { return &values[key * width]; };
  const auto after = std::upper_bound(times.begin(), times.end(), time_s);
  const std::size_t last = times.size() - 1;
  if (after == times.begin()) return {row(0), row(0) + width};
  if (after == times.end()) return {row(last), row(last) + width};
  const auto b = static_cast<std::size_t>(after - times.begin()), a = b - 1;
  const double h = times[b] - times[a], u = (time_s - times[a]) / h;
  std::vector<double> result(width);
  for (std::size_t k = 0; k < width; ++k) {
    const auto secant = [&](std::size_t key) {
      return (row(key + 1)[k] - row(key)[k]) / (times[key + 1] - times[key]);
    };
    const double s = secant(a);
    const double m0 = a > 0 ? slope(secant(a - 1), s, times[a] - times[a - 1], h) : 0;
    const double m1 = b < last ? slope(s, secant(b), h, times[b + 1] - times[b]) : 0;
    const double v = 1 - u;
    result[k] = v * v * (1 + 2 * u) * row(a)[k] + u * u * (3 - 2 * u) * row(b)[k] + h * u * v * (v * m0 - u * m1);
  }
  return result;
}

std::vector<Vec3> Script::handles_at(double time_s) const {
  const double time = loops_ && duration_s_ > 0 ? time_s - duration_s_ * std::floor(time_s / duration_s_) : time_s;
  std::vector<Vec3> handles = rest_;
  for (const Move& move : moves_) {
    const std::vector<double> values = move.track.at(time);
    for (std::size_t i = 0; i < move.handles.size(); ++i) {
      Vec3& p = handles[move.handles[i]];
      p = moved_by(move, box_, p, i, values);
    }
  }
  return handles;
}

using nlohmann::json;

/// The first thing that is wrong is kept with where it is.
class ScriptParser {
 public:
  explicit ScriptParser(std::span<const Vec3> handles) {
    script_.rest_.assign(handles.begin(), handles.end());
    script_.box_ = bounding_box(handles);
  }
  Result<Script> parse(const json& root) {
    const auto whole = [&] {
      if (!know(root, {"loop", "moves"})) return false;
      const json loop = root.value("loop", json(false));
      if (!loop.is_boolean()) return wrong("\"loop\" must be true or false");
      script_.loops_ = loop.get<bool>();
      const json moves = root.value("moves", json());
      if (!moves.is_array() || moves.empty()) return wrong("\"moves\" must be a list of one or more moves");
      for (std::size_t i = 0; i < moves.size(); ++i) {
        where_ = "move " + std::to_string(i);
        if (!move(moves[i])) return false;
      }
      return true;
    };
    if (!whole()) return fail(ErrorCode::kCorrupt, "script: " + error_);
    return std::move(script_);
  }

 private:
  static constexpr double kMaxSeconds = 1e6;
  static constexpr std::size_t kMaxKeys = 100'000;

  bool wrong(const std::string& what) {
    if (error_.empty()) error_ = (where_.empty() ? "" : where_ + ": ") + what;
    return false;
  }
  bool know(const json& object, std::initializer_list<std::string_view> names) {
    if (!object.is_object()) return wrong("must be an object in braces");
    for (const auto& [name, ignored] : object.items()) {
      if (std::find(names.begin(), names.end(), name) == names.end()) return wrong("\"" + name + "\" is not known");
    }
    return true;
  }
  bool number(const json& value, const std::string& name, double& out) {
    if (!value.is_number() || !std::isfinite(value.get<double>())) return wrong("\"" + name + "\" must be a number");
    out = value.get<double>();
    return true;
  }
  bool point(const json& value, const std::string& name, Vec3& out) {
    if (!value.is_array() || value.size() != 3) return wrong("\"" + name + "\" must be three numbers");
    for (std::size_t c = 0; c < 3; ++c) {
      if (!number(value[c], name, out[c])) return false;
    }
    return true;
  }
  bool axis(const json& move, const char* name, std::size_t& out) {
    const json value = move.value(name, json("?"));
    static constexpr std::array<std::string_view, 3> kAxes{"x", "y", "z"};
    const auto found =
        value.is_string() ? std::find(kAxes.begin(), kAxes.end(), value.get<std::string>()) : kAxes.end();
    if (found == kAxes.end()) return wrong(std::string("\"") + name + "\" must be \"x\", \"y\" or \"z\"");
    out = static_cast<std::size_t>(found - kAxes.begin());
    return true;
  }
  bool kind(const json& move, Move& out) {
    static constexpr std::array<std::string_view, 6> kKinds{"twist",     "bend",  "rotate",
                                                            "translate", "scale", "position"};
    const json name = move.value("move", json(""));
    const auto found =
        name.is_string() ? std::find(kKinds.begin(), kKinds.end(), name.get<std::string>()) : kKinds.end();
    if (found == kKinds.end()) return wrong("\"move\" must be twist, bend, rotate, translate, scale or position");
    out.kind = static_cast<Move::Kind>(found - kKinds.begin());
    const bool turns = out.kind <= Move::Kind::kRotate;
    if (turns && !axis(move, "axis", out.frame.axis)) return false;
    if (out.kind == Move::Kind::kBend) {
      if (!axis(move, "towards", out.frame.towards)) return false;
      if (out.frame.towards == out.frame.axis) return wrong("\"towards\" must be another axis than \"axis\"");
    }
    for (std::size_t c = 0; c < 3; ++c) out.centre[c] = (script_.box_.low[c] + script_.box_.high[c]) / 2;
    return !move.contains("centre") || point(move["centre"], "centre", out.centre);
  }

  bool which(const json& move, Move& out) {
    const std::size_t count = script_.rest_.size();
    if (!move.contains("handles")) {
      out.handles.resize(count);
      std::iota(out.handles.begin(), out.handles.end(), 0u);
      return true;
    }
    const json& chosen = move["handles"];
    if (chosen.is_array()) {
      for (const json& index : chosen) {
        if (!index.is_number_unsigned() || index.get<std::uint64_t>() >= count)
          return wrong("\"handles\" must be numbers below " + std::to_string(count));
        out.handles.push_back(index.get<std::uint32_t>());
      }
    } else {
      Vec3 low, high;
      if (!know(chosen, {"low", "high"}) || !point(chosen.value("low", json()), "low", low) ||
          !point(chosen.value("high", json()), "high", high))
        return false;
      for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3& p = script_.rest_[i];
        if (low[0] <= p[0] && p[0] <= high[0] && low[1] <= p[1] && p[1] <= high[1] && low[2] <= p[2] && p[2] <= high[2])
          out.handles.push_back(i);
      }
    }
    return !out.handles.empty() || wrong("\"handles\" chooses none");
  }

  bool keys(const json& move, Move& out) {
    const json all = move.value("keys", json());
    if (!all.is_array() || all.empty() || all.size() > kMaxKeys)
      return wrong("\"keys\" must be a list of 1 to " + std::to_string(kMaxKeys) + " keys");
    const std::string outer = where_;
    Track& track = out.track;
    track.width = out.kind <= Move::Kind::kRotate ? 1 : out.kind == Move::Kind::kPosition ? 3 * out.handles.size() : 3;
    for (std::size_t i = 0; i < all.size(); ++i) {
      where_ = outer + ", key " + std::to_string(i);
      double at = 0;
      if (!values(all[i], out, track.values) || !number(all[i].value("at", json()), "at", at)) return false;
      if (at < 0 || at > kMaxSeconds || (i > 0 && at <= track.times.back()))
        return wrong("\"at\" must be seconds from 0 on, growing from key to key");
      track.times.push_back(at);
    }
    where_ = outer;
    return true;
  }

  bool values(const json& key, const Move& move, std::vector<double>& out) {
    if (move.kind <= Move::Kind::kRotate) {
      double degrees = 0;
      if (!know(key, {"at", "degrees"}) || !number(key.value("degrees", json()), "degrees", degrees)) return false;
      out.push_back(degrees * std::numbers::pi / 180);
      return true;
    }
    if (move.kind != Move::Kind::kPosition) {
      Vec3 by;
      if (!know(key, {"at", "by"}) || !point(key.value("by", json()), "by", by)) return false;
      out.insert(out.end(), by.begin(), by.end());
      return true;
    }
    const json positions = key.value("positions", json());
    if (!know(key, {"at", "positions"})) return false;
    if (!positions.is_array() || positions.size() != move.handles.size())
      return wrong("\"positions\" must be " + std::to_string(move.handles.size()) + " points");
    for (const json& position : positions) {
      Vec3 p;
      if (!point(position, "positions", p)) return false;
      out.insert(out.end(), p.begin(), p.end());
    }
    return true;
  }

  bool move(const json& move) {
    Move made;
    if (!know(move, {"move", "axis", "towards", "centre", "handles", "keys"}) || !kind(move, made) ||
        !which(move, made) || !keys(move, made))
      return false;
    script_.duration_s_ = std::max(script_.duration_s_, made.track.times.back());
    script_.moves_.push_back(std::move(made));
    return true;
  }

  Script script_;
  std::string where_, error_;
};

Result<Script> Script::from_json(std::string_view text, std::span<const Vec3> handles) {
  const json root = json::parse(text, nullptr, false);
  if (root.is_discarded()) return fail(ErrorCode::kCorrupt, "script: this is not JSON");
  try {
    return ScriptParser(handles).parse(root);
  } catch (const json::exception& error) {
    return fail(ErrorCode::kCorrupt, std::string("script: ") + error.what());
  }
}

Result<Script> Script::builtin(std::string_view name, std::span<const Vec3> handles) {
  const auto there_and_back = [](double degrees) {
    return json{{{"at", 0}, {"degrees", 0}},
                {{"at", 1}, {"degrees", degrees}},
                {{"at", 3}, {"degrees", -degrees}},
                {{"at", 4}, {"degrees", 0}}};
  };
  const auto twist = [&](double degrees) {
    return json{{"move", "twist"}, {"axis", "y"}, {"keys", there_and_back(degrees)}};
  };
  const auto bend = [&](double degrees) {
    return json{{"move", "bend"}, {"axis", "y"}, {"towards", "x"}, {"keys", there_and_back(degrees)}};
  };
  json moves = json::array();
  if (name == "twist") {
    moves.push_back(twist(180));
  } else if (name == "bend") {
    moves.push_back(bend(180));
  } else if (name == "both") {
    moves.push_back(twist(90));
    moves.push_back(bend(90));
  } else {
    return fail(ErrorCode::kNotFound, "\"" + std::string(name) + "\" is not a built-in script: twist, bend, both");
  }
  return ScriptParser(handles).parse({{"loop", true}, {"moves", std::move(moves)}});
}

}  // namespace eigencast::deform
