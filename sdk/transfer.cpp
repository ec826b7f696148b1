// SPDX-License-Identifier: MIT
#include "sdk/transfer.h"

#include <algorithm>

#include "common/spectral/prefix_fit.h"

namespace eigencast {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Eigen::MatrixXd first_rows(const Asset& asset, std::uint32_t N) {
  Eigen::MatrixXd rows(N, asset.rank);
  for (std::uint32_t i = 0; i < N; ++i) {
    for (std::uint32_t k = 0; k < asset.rank; ++k) rows(i, k) = static_cast<double>(asset.entry(i, k));
  }
  return rows;
}

/// How many vertices the fit takes.
std::uint32_t fitted(const Asset& from, const Asset& to, std::uint32_t most) {
  const std::uint32_t wanted = std::max(most, 8 * std::max(from.rank, to.rank));
  return std::min({wanted, from.rows_ready, to.rows_ready});
}

bool are_alike(const Asset& a, const Asset& b, std::uint32_t N) {
  return a.vertex_count == b.vertex_count && a.base_count == b.base_count && a.origin == b.origin &&
         a.face_total == b.face_total && a.detail.size() == 0 && b.detail.size() == 0 && a.source_vertex.size() >= N &&
         b.source_vertex.size() >= N &&
         std::equal(a.source_vertex.begin(), a.source_vertex.begin() + N, b.source_vertex.begin());
}

}  // namespace

std::optional<Transfer> Transfer::between(const Asset& from, const Asset& to) {
  const std::uint32_t N = fitted(from, to, kMostVertices);
  if (N < to.rank || !are_alike(from, to, N)) return std::nullopt;
  const Eigen::VectorXd mass = Eigen::Map<const Eigen::VectorXf>(to.mass.data(), N).cast<double>();
  const PrefixFit fit(first_rows(to, N), mass, first_rows(from, N), to.vertex_count);
  const RowMajor T = fit.coefficients(static_cast<int>(to.rank));
  if (!T.allFinite()) return std::nullopt;
  Transfer transfer;
  transfer.from_ = from.rank;
  transfer.to_ = to.rank;
  transfer.T_.assign(T.data(), T.data() + T.size());
  return transfer;
}

Transfer::Cost Transfer::cost(const Asset& from, const Asset& to) {
  const std::uint64_t N = fitted(from, to, kMostVertices), f = from.rank, t = to.rank;
  return {sizeof(double) * (2 * N + 3 * t) * (f + t), N * t * (f + t)};  // Rows and weighted rows; Gram matrices.
}

std::vector<double> Transfer::apply(std::span<const double> C, std::size_t channels) const {
  if (C.size() != from_ * channels) return {};
  const Eigen::Map<const RowMajor> T(T_.data(), to_, from_);
  const Eigen::Map<const RowMajor> from(C.data(), from_, static_cast<Eigen::Index>(channels));
  const RowMajor to = T * from;
  return {to.data(), to.data() + to.size()};
}

}  // namespace eigencast
