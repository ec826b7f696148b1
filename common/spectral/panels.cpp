// SPDX-License-Identifier: MIT
#include "common/spectral/panels.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cassert>
#include <cstring>
#include <new>

#include "common/core/worker_team.h"

namespace eigencast {

extern const PanelFunctions baseline_panel_functions;
#if defined(__x86_64__)
extern const PanelFunctions avx2_panel_functions;
extern const PanelFunctions avx512_panel_functions;
#endif

const PanelFunctions& panel_functions(InstructionSet set) {
#if defined(__x86_64__)
  if (set >= InstructionSet::kAvx512) return avx512_panel_functions;
  if (set == InstructionSet::kAvx2) return avx2_panel_functions;
#endif
  static_cast<void>(set);
  return baseline_panel_functions;
}
const PanelFunctions& panel_functions() {
  static const PanelFunctions& best = panel_functions(instruction_sets().back());
  return best;
}

namespace {

constexpr Eigen::Index kStripes = 8;       // of rows; no sum may depend on the number of threads
constexpr Eigen::Index kRowsAtOnce = 512;  // of a panel: 32 KiB
constexpr Eigen::Index kFewRows = 64;      // of all panels
constexpr std::align_val_t kAlignment{64};

using PanelBlock = Eigen::Matrix<double, kWidth, kWidth, Eigen::RowMajor>;
using PanelMatrix = Eigen::Matrix<double, Eigen::Dynamic, kWidth, Eigen::RowMajor>;

/// work(stripe, first row, rows) for at most `at_once` rows at a time, in order; stripes at the same time.
void for_rows(Eigen::Index rows, Eigen::Index at_once,
              const std::function<void(std::size_t, Eigen::Index, std::size_t)>& work) {
  for_panels(kStripes, [&](Eigen::Index stripe) {
    const Eigen::Index end = rows * (stripe + 1) / kStripes;
    for (Eigen::Index row = rows * stripe / kStripes; row < end; row += at_once) {
      work(static_cast<std::size_t>(stripe), row, static_cast<std::size_t>(std::min(at_once, end - row)));
    }
  });
}

/// Sums of each stripe, all zero.
std::vector<std::vector<PanelBlock>> zero_sums(Eigen::Index count) {
  return {kStripes, std::vector<PanelBlock>(static_cast<std::size_t>(count), PanelBlock::Zero())};
}

}  // namespace

void for_panels(Eigen::Index count, const std::function<void(Eigen::Index)>& work) {
  worker_team().run(static_cast<std::size_t>(count), [&](std::size_t j) { work(static_cast<Eigen::Index>(j)); });
}

void Panels::Free::operator()(double* at) const {
  ::operator delete(at, kAlignment);
}

double* Panels::append() {
  const std::size_t bytes = static_cast<std::size_t>(rows_) * kPanelWidth * sizeof(double);
  panels_.emplace_back(static_cast<double*>(::operator new(bytes, kAlignment)));
  std::memset(panels_.back().get(), 0, bytes);
  return panels_.back().get();
}

void copy_column(const Panels& from, Eigen::Index i, Panels& to, Eigen::Index j) {
  for (Eigen::Index row = 0; row < from.rows(); ++row) to.at(row, j) = from.at(row, i);
}

Panels zero_panels(Eigen::Index rows, Eigen::Index columns) {
  Panels panels(rows);
  while (panels.columns() < columns) panels.append();
  return panels;
}

Panels panels_from(const Eigen::MatrixXd& X) {
  Panels A = zero_panels(X.rows(), X.cols());
  for_panels(A.count(), [&](Eigen::Index j) {
    const Eigen::Index first = j * kWidth, here = std::min(kWidth, X.cols() - first);
    PanelMatrix::Map(A[j], A.rows(), kWidth).leftCols(here) = X.middleCols(first, here);
  });
  return A;
}

Eigen::MatrixXd matrix_from(const Panels& A, Eigen::Index count) {
  Eigen::MatrixXd X(A.rows(), count);
  for_panels(whole_panels(count) / kWidth, [&](Eigen::Index j) {
    const Eigen::Index first = j * kWidth, here = std::min(kWidth, count - first);
    X.middleCols(first, here) = PanelMatrix::Map(A[j], A.rows(), kWidth).leftCols(here);
  });
  return X;
}

Eigen::MatrixXd transposed_product(const Panels& A, Eigen::Index first, Eigen::Index end, const double* W) {
  const PanelFunctions& functions = panel_functions();
  auto parts = zero_sums(end - first);
  for_rows(A.rows(), kRowsAtOnce, [&](std::size_t stripe, Eigen::Index row, std::size_t rows) {
    for (Eigen::Index j = first; j < end; ++j) {
      functions.add_gram(A[j] + row * kWidth, W + row * kWidth, rows,
                         parts[stripe][static_cast<std::size_t>(j - first)].data());
    }
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero((end - first) * kWidth, kWidth);
  for (const auto& sums : parts) {
    for (std::size_t j = 0; j < sums.size(); ++j)
      G.middleRows(static_cast<Eigen::Index>(j) * kWidth, kWidth) += sums[j];
  }
  return G;
}

void subtract_product(const Panels& A, Eigen::Index first, Eigen::Index end, const Eigen::MatrixXd& H, double* W) {
  assert(H.rows() == (end - first) * kWidth && H.cols() == kWidth);
  const PanelFunctions& functions = panel_functions();
  std::vector<PanelBlock> blocks;
  for (Eigen::Index j = 0; j < H.rows(); j += kWidth) blocks.push_back(-H.middleRows(j, kWidth));
  for_rows(A.rows(), kRowsAtOnce, [&](std::size_t, Eigen::Index row, std::size_t rows) {
    for (Eigen::Index j = first; j < end; ++j) {
      const PanelBlock& block = blocks[static_cast<std::size_t>(j - first)];
      functions.add_product(A[j] + row * kWidth, block.data(), rows, W + row * kWidth);
    }
  });
}

void scatter_rows(const double* from, const int* to_row, Eigen::Index rows, double* to) {
  for_rows(rows, kRowsAtOnce, [&](std::size_t, Eigen::Index row, std::size_t count) {
    const Eigen::Index end = row + static_cast<Eigen::Index>(count);
    for (Eigen::Index i = row; i < end; ++i) std::memcpy(to + to_row[i] * kWidth, from + i * kWidth, 8 * kWidth);
  });
}

void gather_rows(const double* from, const int* from_row, Eigen::Index rows, double* to) {
  for_rows(rows, kRowsAtOnce, [&](std::size_t, Eigen::Index row, std::size_t count) {
    const Eigen::Index end = row + static_cast<Eigen::Index>(count);
    for (Eigen::Index i = row; i < end; ++i) std::memcpy(to + i * kWidth, from + from_row[i] * kWidth, 8 * kWidth);
  });
}

void multiply_panel(double* W, Eigen::Index rows, const Eigen::MatrixXd& T) {
  const PanelFunctions& functions = panel_functions();
  const PanelBlock block = T;
  for_rows(rows, kRowsAtOnce, [&](std::size_t, Eigen::Index row, std::size_t count) {
    double* here = W + row * kWidth;
    const std::vector<double> old(here, here + count * kPanelWidth);
    std::fill_n(here, old.size(), 0.0);
    functions.add_product(old.data(), block.data(), count, here);
  });
}

Eigen::MatrixXd panel_gram(const double* W, Eigen::Index rows) {
  const PanelFunctions& functions = panel_functions();
  auto parts = zero_sums(1);
  for_rows(rows, kRowsAtOnce, [&](std::size_t stripe, Eigen::Index row, std::size_t count) {
    functions.add_gram(W + row * kWidth, W + row * kWidth, count, parts[stripe].front().data());
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(kWidth, kWidth);
  for (const auto& sums : parts) G += sums.front();
  return G;
}

Eigen::MatrixXd gram(const Panels& A) {
  const PanelFunctions& functions = panel_functions();
  const Eigen::Index count = A.count();
  auto parts = zero_sums(count * count);
  for_rows(A.rows(), kFewRows, [&](std::size_t stripe, Eigen::Index row, std::size_t rows) {
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        functions.add_gram(A[i] + row * kWidth, A[j] + row * kWidth, rows,
                           parts[stripe][static_cast<std::size_t>(i * count + j)].data());
      }
    }
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(A.columns(), A.columns());
  for (const auto& sums : parts) {
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        G.block(i * kWidth, j * kWidth, kWidth, kWidth) += sums[static_cast<std::size_t>(i * count + j)];
      }
    }
  }
  G.triangularView<Eigen::StrictlyUpper>() = G.transpose();
  return G;
}

void rotate(Panels& A, const Eigen::MatrixXd& T) {
  assert(T.rows() == A.columns() && T.cols() % kWidth == 0 && T.cols() <= T.rows());
  const PanelFunctions& functions = panel_functions();
  const Eigen::Index from = A.count(), to = T.cols() / kWidth;
  std::vector<PanelBlock> blocks;
  std::vector<char> empty;
  for (Eigen::Index j = 0; j < to; ++j) {
    for (Eigen::Index i = 0; i < from; ++i) {
      blocks.push_back(T.block(i * kWidth, j * kWidth, kWidth, kWidth));
      empty.push_back(blocks.back().isZero(0));
    }
  }
  constexpr Eigen::Index kRoom = kFewRows * kWidth;
  std::vector<std::vector<double>> results(kStripes, std::vector<double>(static_cast<std::size_t>(to * kRoom)));
  for_rows(A.rows(), kFewRows, [&](std::size_t stripe, Eigen::Index row, std::size_t rows) {
    std::vector<double>& result = results[stripe];
    std::fill(result.begin(), result.end(), 0.0);
    for (Eigen::Index j = 0; j < to; ++j) {
      for (Eigen::Index i = 0; i < from; ++i) {
        const auto block = static_cast<std::size_t>(j * from + i);
        if (empty[block]) continue;
        functions.add_product(A[i] + row * kWidth, blocks[block].data(), rows, result.data() + j * kRoom);
      }
    }
    for (Eigen::Index j = 0; j < to; ++j)
      std::copy_n(result.data() + j * kRoom, rows * kPanelWidth, A[j] + row * kWidth);
  });
  A.drop_from(to);
}

bool orthonormalise(Panels& H, Eigen::Index m) {
  const Eigen::MatrixXd G = gram(H).topLeftCorner(m, m);
  const Eigen::LLT<Eigen::MatrixXd> cholesky(G);
  if (cholesky.info() != Eigen::Success) return false;
  Eigen::MatrixXd T = Eigen::MatrixXd::Zero(H.columns(), H.columns());
  T.topLeftCorner(m, m) = cholesky.matrixU().solve(Eigen::MatrixXd::Identity(m, m));
  rotate(H, T);
  return true;
}

}  // namespace eigencast
