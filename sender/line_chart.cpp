// SPDX-License-Identifier: MIT
#include "sender/line_chart.h"

#include <stb/stb_easy_font.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr int kWidth = 1200, kHeight = 720;
constexpr int kLeft = 130, kTop = 90, kBottom = 90, kRight = 30;
constexpr int kLegendKey = 46;  // pixels for the piece of line before a name
constexpr int kTextScale = 2;   // the font is 7 pixels high
constexpr int kLineHeight = 26;
constexpr double kPen = 2.5, kDash = 9, kGap = 7;  // pixels; dashes where the colours come again
constexpr std::size_t kMarkedPoints = 40;          // lines of more have no dots

using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kInk = {40, 40, 40}, kGrid = {225, 225, 225};
// Told apart by colour-blind people, too (Okabe & Ito 2008, "Color Universal Design").
constexpr std::array<Colour, 7> kColours = {
    {{0, 114, 178}, {213, 94, 0}, {0, 158, 115}, {204, 121, 167}, {230, 159, 0}, {86, 180, 233}, {0, 0, 0}}};

class Canvas {
 public:
  Canvas() : picture_{kWidth, kHeight, std::vector<std::uint8_t>(std::size_t{3} * kWidth * kHeight, 255)} {}

  void blend(int x, int y, const Colour& colour, double cover) {
    if (x < 0 || y < 0 || x >= kWidth || y >= kHeight || !(cover > 0)) return;
    std::uint8_t* pixel = &picture_.rgb[3 * (static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x))];
    for (std::size_t c = 0; c < 3; ++c)
      pixel[c] = static_cast<std::uint8_t>(std::lround(pixel[c] + std::min(cover, 1.0) * (colour[c] - pixel[c])));
  }
  /// Of round ends, with soft rims.
  void line(double x0, double y0, double x1, double y1, const Colour& colour, double width) {
    const double reach = width / 2 + 1, dx = x1 - x0, dy = y1 - y0, squared = dx * dx + dy * dy;
    const int bottom = static_cast<int>(std::ceil(std::max(y0, y1) + reach)),
              right = static_cast<int>(std::ceil(std::max(x0, x1) + reach));
    for (int y = static_cast<int>(std::min(y0, y1) - reach); y <= bottom; ++y) {
      for (int x = static_cast<int>(std::min(x0, x1) - reach); x <= right; ++x) {
        const double px = x + 0.5 - x0, py = y + 0.5 - y0;
        const double t = squared > 0 ? std::clamp((px * dx + py * dy) / squared, 0.0, 1.0) : 0;
        blend(x, y, colour, width / 2 + 0.5 - std::hypot(px - t * dx, py - t * dy));
      }
    }
  }
  void text(int x, int y, const std::string& words) {
    struct Corner {
      float x, y, z;
      std::uint8_t colour[4];
    };
    std::vector<Corner> corners(words.size() * 200 + 4);
    std::string copy = words;
    const int quads = stb_easy_font_print(0, 0, copy.data(), nullptr, corners.data(),
                                          static_cast<int>(corners.size() * sizeof(Corner)));
    for (int q = 0; q < quads; ++q) {
      const Corner &low = corners[static_cast<std::size_t>(4 * q)],
                   &high = corners[static_cast<std::size_t>(4 * q + 2)];
      for (int py = static_cast<int>(low.y) * kTextScale; py < static_cast<int>(high.y) * kTextScale; ++py) {
        for (int px = static_cast<int>(low.x) * kTextScale; px < static_cast<int>(high.x) * kTextScale; ++px)
          blend(x + px, y + py, kInk, 1);
      }
    }
  }
  static int text_width(const std::string& words) {
    std::string copy = words;
    return kTextScale * stb_easy_font_width(copy.data());
  }
  Picture take() { return std::move(picture_); }

 private:
  Picture picture_;
};

/// Values to pixels along one side.
class Axis {
 public:
  Axis(double low, double high, bool logarithmic, double from_px, double to_px)
      : log_(logarithmic), from_px_(from_px), to_px_(to_px) {
    if (!(low <= high)) low = 0.1, high = 1;
    if (low == high) low = log_ ? low / 2 : low - 0.5 * std::abs(low) - 0.5, high = log_ ? high * 2 : high + 0.5;
    const double room = 0.04 * (at(high) - at(low));
    low_ = log_ ? std::exp(at(low) - room) : low - room;
    high_ = log_ ? std::exp(at(high) + room) : high + room;
  }
  bool shows(double value) const { return std::isfinite(value) && (!log_ || value > 0); }
  double pixel(double value) const {
    return from_px_ + (at(value) - at(low_)) / (at(high_) - at(low_)) * (to_px_ - from_px_);
  }
  std::vector<double> marks() const { return axis_marks(low_, high_, log_); }

 private:
  double at(double value) const { return log_ ? std::log(value) : value; }
  bool log_;
  double low_ = 0, high_ = 1, from_px_, to_px_;
};

Axis axis_of(const LineChart& chart, bool x, double from_px, double to_px) {
  const bool logarithmic = x ? chart.log_x : chart.log_y;
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (const LineChart::Line& line : chart.lines) {
    for (const auto& point : line.points) {
      const double value = x ? point.first : point.second;
      if (!std::isfinite(value) || (logarithmic && !(value > 0))) continue;
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  return {low, high, logarithmic, from_px, to_px};
}

void draw_axes(Canvas& canvas, const LineChart& chart, const Axis& x, const Axis& y, int right) {
  for (const double mark : x.marks()) {
    const double px = x.pixel(mark);
    canvas.line(px, kTop, px, kHeight - kBottom, kGrid, 1);
    const std::string number = formatted("%g", mark);
    canvas.text(static_cast<int>(px) - Canvas::text_width(number) / 2, kHeight - kBottom + 12, number);
  }
  for (const double mark : y.marks()) {
    const double py = y.pixel(mark);
    canvas.line(kLeft, py, right, py, kGrid, 1);
    const std::string number = formatted("%g", mark);
    canvas.text(kLeft - 12 - Canvas::text_width(number), static_cast<int>(py) - 7, number);
  }
  canvas.line(kLeft, kTop, kLeft, kHeight - kBottom, kInk, 1.5);
  canvas.line(kLeft, kHeight - kBottom, right, kHeight - kBottom, kInk, 1.5);
  canvas.text(kLeft, 16, chart.title);
  canvas.text(20, kTop - 32, chart.y_label);
  canvas.text((kLeft + right - Canvas::text_width(chart.x_label)) / 2, kHeight - 40, chart.x_label);
}

/// Where the dashes of a line are, pixel by pixel along it.
class Pen {
 public:
  Pen(Canvas& canvas, const Colour& colour, bool dashed) : canvas_(canvas), colour_(colour), dashed_(dashed) {}
  void draw(double x0, double y0, double x1, double y1) {
    if (!dashed_) return canvas_.line(x0, y0, x1, y1, colour_, kPen);
    const double length = std::hypot(x1 - x0, y1 - y0);
    double from = 0;
    while (from < length) {
      const double in_period = std::fmod(drawn_ + from, kDash + kGap);
      const bool down = in_period < kDash;
      const double to = std::min(length, from + (down ? kDash : kDash + kGap) - in_period + 1e-9);
      const auto at = [&](double along, double a, double b) { return a + along / length * (b - a); };
      if (down) canvas_.line(at(from, x0, x1), at(from, y0, y1), at(to, x0, x1), at(to, y0, y1), colour_, kPen);
      from = to;
    }
    drawn_ += length;
  }

 private:
  Canvas& canvas_;
  const Colour& colour_;
  bool dashed_;
  double drawn_ = 0;
};

void draw_line(Canvas& canvas, const LineChart::Line& line, const Axis& x, const Axis& y, const Colour& colour,
               bool dashed) {
  Pen pen(canvas, colour, dashed);
  const std::pair<double, double>* before = nullptr;
  for (const auto& point : line.points) {
    if (!x.shows(point.first) || !y.shows(point.second)) {
      before = nullptr;
      continue;
    }
    const double px = x.pixel(point.first), py = y.pixel(point.second);
    if (before != nullptr) pen.draw(x.pixel(before->first), y.pixel(before->second), px, py);
    if (line.points.size() <= kMarkedPoints) canvas.line(px, py, px, py, colour, 9);
    before = &point;
  }
}

}  // namespace

std::vector<double> axis_marks(double low, double high, bool logarithmic) {
  std::vector<double> marks;
  if (logarithmic && high / low > 4) {
    const double decades = std::log10(high / low);
    for (double decade = std::floor(std::log10(low)); decade <= std::log10(high); ++decade) {
      for (const double digit : {1.0, 2.0, 5.0}) {
        const double mark = digit * std::pow(10.0, decade);
        if (mark >= low && mark <= high && (digit == 1 || decades < 3.5)) marks.push_back(mark);
      }
    }
    if (marks.size() >= 3) return marks;
    marks.clear();
  }
  const double rough = (high - low) / 6, power = std::pow(10.0, std::floor(std::log10(rough)));
  const double step = power * (rough / power < 1.5 ? 1 : rough / power < 3.5 ? 2 : rough / power < 7.5 ? 5 : 10);
  for (double count = std::ceil(low / step); count * step <= high; ++count)
    marks.push_back(count * step + 0.0);  // no -0
  return marks;
}

Picture picture_of(const LineChart& chart) {
  int names = 0;
  for (const LineChart::Line& line : chart.lines) names = std::max(names, Canvas::text_width(line.name));
  const int right = kWidth - kRight - (names > 0 ? names + kLegendKey + 20 : 0);
  const Axis x = axis_of(chart, true, kLeft, right), y = axis_of(chart, false, kHeight - kBottom, kTop);
  Canvas canvas;
  draw_axes(canvas, chart, x, y, right);
  for (std::size_t i = 0; i < chart.lines.size(); ++i) {
    const Colour& colour = kColours[i % kColours.size()];
    const bool dashed = i / kColours.size() % 2 == 1;
    draw_line(canvas, chart.lines[i], x, y, colour, dashed);
    if (chart.lines[i].name.empty()) continue;
    const int row = kTop + static_cast<int>(i) * kLineHeight;
    Pen(canvas, colour, dashed).draw(right + 20, row + 7, right + 20 + kLegendKey - 12, row + 7);
    canvas.text(right + 20 + kLegendKey, row, chart.lines[i].name);
  }
  return canvas.take();
}

}  // namespace eigencast
