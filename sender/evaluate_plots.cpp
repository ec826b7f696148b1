// SPDX-License-Identifier: MIT
#include <algorithm>
#include <filesystem>
#include <functional>

#include "common/core/text.h"
#include "sender/evaluate_report.h"
#include "sender/line_chart.h"

namespace eigencast {
namespace {

/// Basis, rank and, if there are several, codec.
std::string name_of(const EvaluatedClip& clip, const EvaluatedRow& row) {
  const bool several = std::any_of(clip.rows.begin(), clip.rows.end(),
                                   [&](const EvaluatedRow& other) { return other.codec != clip.rows.front().codec; });
  return formatted("%s %u", row.basis.c_str(), row.rank) + (several ? ", " + row.codec : "");
}

LineChart by_frame(const EvaluatedClip& clip) {
  LineChart chart{"Error of each frame at full detail: " + clip.input, "frame", "rms / diagonal", false, true, {}};
  for (const EvaluatedRow& row : clip.rows) {
    LineChart::Line line{name_of(clip, row), {}};
    for (std::size_t frame = 0; frame < row.evaluation.rms_by_frame.size(); ++frame)
      line.points.emplace_back(static_cast<double>(frame), row.evaluation.rms_by_frame[frame]);
    chart.lines.push_back(std::move(line));
  }
  return chart;
}

/// One point for each row, joined along x where the names agree.
LineChart by_row(LineChart chart, const EvaluatedClip& clip,
                 const std::function<std::string(const EvaluatedRow&)>& name,
                 const std::function<double(const EvaluatedRow&)>& x) {
  for (const EvaluatedRow& row : clip.rows) {
    auto line = std::find_if(chart.lines.begin(), chart.lines.end(),
                             [&](const LineChart::Line& other) { return other.name == name(row); });
    if (line == chart.lines.end()) line = chart.lines.insert(line, {name(row), {}});
    line->points.emplace_back(x(row), row.evaluation.total.rms);
  }
  for (LineChart::Line& line : chart.lines) std::sort(line.points.begin(), line.points.end());
  return chart;
}

LineChart by_level(const EvaluatedClip& clip) {
  LineChart chart{"Level of detail: " + clip.input, "fraction of the vertices", "Hausdorff / diagonal", true, true, {}};
  for (const EvaluatedRow& row : clip.rows) {
    LineChart::Line line{name_of(clip, row), {}};
    for (const LevelError& level : row.evaluation.levels) line.points.emplace_back(level.fraction, level.hausdorff);
    std::sort(line.points.begin(), line.points.end());
    chart.lines.push_back(std::move(line));
  }
  return chart;
}

bool has_a_line(const LineChart& chart) {
  return std::any_of(chart.lines.begin(), chart.lines.end(),
                     [](const LineChart::Line& line) { return line.points.front().first < line.points.back().first; });
}

}  // namespace

Result<std::vector<std::string>> write_plots(const EvaluatedClip& clip, const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return fail(ErrorCode::kIo, folder + ": cannot be made: " + error.message());
  const auto rank = [](const EvaluatedRow& row) { return static_cast<double>(row.rank); };
  const auto rate = [&](const EvaluatedRow& row) { return row.evaluation.wire_kbit_per_s(clip.rate_hz); };
  const std::pair<const char*, LineChart> charts[] = {
      {"error_by_frame.png", by_frame(clip)},
      {"error_by_rank.png",
       by_row(
           {"Error at full detail: " + clip.input, "coefficients an axis", "rms / diagonal", true, true, {}}, clip,
           [](const EvaluatedRow& row) { return row.basis + ", " + row.codec; }, rank)},
      {"error_by_rate.png",
       by_row(
           {"Error and rate: " + clip.input,
            formatted("kbit/s at %g poses/s", clip.rate_hz),
            "rms / diagonal",
            true,
            true,
            {}},
           clip, [](const EvaluatedRow& row) { return formatted("%s %u", row.basis.c_str(), row.rank); }, rate)},
      {"error_by_level.png", by_level(clip)}};
  std::vector<std::string> written;
  for (const auto& [name, chart] : charts) {
    if (!has_a_line(chart)) continue;
    const std::string path = folder + "/" + name;
    if (const auto put = write_png(path, picture_of(chart)); !put) return put.error();
    written.push_back(path);
  }
  return written;
}

}  // namespace eigencast
