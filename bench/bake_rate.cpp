// SPDX-License-Identifier: MIT
//
// bake_rate [--peers] [--exactly] [--m M] [--repeat N] SHAPE...: seconds for the M lowest eigenpairs (default 200) of
// the Laplacian of surfaces, ours and, with --peers, our second solver (spectra_solver.cpp) and ARPACK with sparse LU
// and with sparse Cholesky: the same pair (L, M), the same shift below zero, one after the other in one run; medians of
// N runs by turns (default 1). SHAPE as bench/named_surface.h has it. --exactly: ours once more without approximation,
// for surfaces of more than 150,000 vertices. Residuals of all are measured by the same lines. For one thread each run
// it under `taskset -c 0`.
#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseLU>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "bench/named_surface.h"
#include "common/core/histogram.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/symmetric_form.h"

#if EIGENCAST_HAS_ARPACK
extern "C" {
void dsaupd_c(int* ido, const char* bmat, int n, const char* which, int nev, double tol, double* resid, int ncv,
              double* v, int ldv, int* iparam, int* ipntr, double* workd, double* workl, int lworkl, int* info);
void dseupd_c(int rvec, const char* howmny, const int* select, double* d, double* z, int ldz, double sigma,
              const char* bmat, int n, const char* which, int nev, double tol, double* resid, int ncv, double* v,
              int ldv, int* iparam, int* ipntr, double* workd, double* workl, int lworkl, int* info);
}
#endif

namespace {

using namespace eigencast;
using Sparse = Eigen::SparseMatrix<double>;

constexpr double kTolerance = 1e-9;

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Counts all threads.
double processor_seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

double shift_of(const Laplacian& laplacian) {
  return -0.01 * 8 * std::numbers::pi / laplacian.area;
}

Sparse shifted(const Laplacian& laplacian) {
  Sparse A = laplacian.L;
  A.diagonal() -= shift_of(laplacian) * laplacian.mass;
  return A;
}

struct Found {
  Eigen::VectorXd values;
  Eigen::MatrixXd Phi;
};

double worst_residual(const Laplacian& laplacian, const Found& found) {
  const Eigen::VectorXd weight = laplacian.mass.cwiseSqrt().cwiseInverse();
  double worst = 0;
  for (Eigen::Index j = 0; j < found.values.size(); ++j) {
    const Eigen::VectorXd phi = found.Phi.col(j);
    const Eigen::VectorXd defect = laplacian.L * phi - found.values[j] * laplacian.mass.cwiseProduct(phi);
    const double size = phi.cwiseProduct(laplacian.mass.cwiseSqrt()).norm();
    worst = std::max(worst, defect.cwiseProduct(weight).norm() / size / std::max(found.values[j], found.values[1]));
  }
  return worst;
}

Found found_in(Result<Eigenbasis> basis) {
  if (!basis) {
    std::fprintf(stderr, "bake_rate: %s\n", basis.error().message.c_str());
    std::exit(1);
  }
  if (basis->approximate) {
    std::printf("  approximate: %s eigenvalues passed over\n",
                basis->missed ? std::to_string(*basis->missed).c_str() : "not counted,");
  } else if (!basis->certified) {
    std::fprintf(stderr, "bake_rate: not certified\n");
  }
  return {std::move(basis->eigenvalues), std::move(basis->Phi)};
}

Found ours(const Laplacian& laplacian, int m, bool exactly) {
  return found_in(exactly ? solve_eigenbasis_exactly(laplacian, m) : solve_eigenbasis(laplacian, m));
}
Found spectra(const Laplacian& laplacian, int m) {
  return found_in(spectra_eigenbasis(laplacian, symmetric_form(laplacian), m, {}));  // of any size
}

#if EIGENCAST_HAS_ARPACK
/// Mode 3 of ARPACK, B = M, as its users' guide gives it.
template <typename Solver>
Found arpack(const Laplacian& laplacian, int m) {
  const int n = static_cast<int>(laplacian.mass.size()), ncv = 2 * m;
  const double sigma = shift_of(laplacian);
  Solver solver;
  solver.compute(shifted(laplacian));
  Eigen::VectorXd residual(n), work(3 * n), small(ncv * (ncv + 8));
  Eigen::MatrixXd V(n, ncv);
  std::vector<int> select(static_cast<std::size_t>(ncv), 1);
  int parameters[11] = {1, 0, 1000, 1, 0, 0, 3, 0, 0, 0, 0}, pointers[14] = {};
  int ido = 0, info = 0;
  const auto lworkl = static_cast<int>(small.size());
  for (;;) {
    dsaupd_c(&ido, "G", n, "LM", m, kTolerance, residual.data(), ncv, V.data(), n, parameters, pointers, work.data(),
             small.data(), lworkl, &info);
    const auto part = [&](int which) { return Eigen::Map<Eigen::VectorXd>(work.data() + pointers[which] - 1, n); };
    if (ido == -1) {
      part(1) = solver.solve(laplacian.mass.cwiseProduct(part(0)).eval());
    } else if (ido == 1) {
      part(1) = solver.solve(Eigen::VectorXd(part(2)));
    } else if (ido == 2) {
      part(1) = laplacian.mass.cwiseProduct(part(0));
    } else {
      break;
    }
  }
  Found found{Eigen::VectorXd(m), Eigen::MatrixXd(n, m)};
  dseupd_c(1, "A", select.data(), found.values.data(), found.Phi.data(), n, sigma, "G", n, "LM", m, kTolerance,
           residual.data(), ncv, V.data(), n, parameters, pointers, work.data(), small.data(), lworkl, &info);
  if (info != 0) std::fprintf(stderr, "bake_rate: ARPACK says %d\n", info);
  return found;
}
#endif

/// What of the rest pose the basis leaves: area-weighted root mean square over the diagonal.
double truncation(const Surface& surface, const Laplacian& laplacian, const Found& found) {
  double left = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd x(laplacian.mass.size());
    for (Eigen::Index i = 0; i < x.size(); ++i) x[i] = surface.positions[static_cast<std::size_t>(i)][axis];
    x.array() -= x.mean();
    const Eigen::VectorXd c = found.Phi.transpose() * laplacian.mass.cwiseProduct(x);
    x -= found.Phi * c;
    left += x.cwiseAbs2().dot(laplacian.mass);
  }
  return std::sqrt(left / laplacian.area) / bounding_box(surface.positions).diagonal();
}

void compare(const std::string& name, int m, int repeats, bool peers, bool exactly) {
  const Surface surface = bench::named_surface(name);
  const double begin = now();
  const auto laplacian = build_laplacian(surface);
  if (!laplacian) return static_cast<void>(std::fprintf(stderr, "%s\n", laplacian.error().message.c_str()));
  std::printf("%s: %zu vertices, m = %d; Laplacian in %.2f s\n", name.c_str(), surface.vertex_count(), m,
              now() - begin);
  struct Peer {
    const char* name;
    std::function<Found()> solve;
    std::vector<double> seconds = {}, used = {};
    Found found = {};
  };
  std::vector<Peer> all{{"ours", [&] { return ours(*laplacian, m, false); }}};
  if (exactly) all.push_back({"ours, exactly", [&] { return ours(*laplacian, m, true); }});
  if (peers) {
#if EIGENCAST_HAS_ARPACK
    all.push_back({"ARPACK, sparse Cholesky", [&] { return arpack<Eigen::SimplicialLLT<Sparse>>(*laplacian, m); }});
    all.push_back({"ARPACK, sparse LU",
                   [&] { return arpack<Eigen::SparseLU<Sparse, Eigen::COLAMDOrdering<int>>>(*laplacian, m); }});
#endif
    all.push_back({"Spectra (--solver spectra)", [&] { return spectra(*laplacian, m); }});
  }
  for (int run = 0; run < repeats; ++run) {
    for (Peer& peer : all) {
      const double start = now(), used_before = processor_seconds();
      peer.found = peer.solve();
      peer.seconds.push_back(now() - start);
      peer.used.push_back(processor_seconds() - used_before);
    }
  }
  const double first = median(all.front().seconds);
  for (const Peer& peer : all) {
    const double seconds = median(peer.seconds), used = median(peer.used);
    const Found& found = peer.found;
    std::printf("  %-30s %8.2f s  %5.1fx  processor %8.2f s  residual %.1e  lambda_m %.6g  rest pose left %.4e\n",
                peer.name, seconds, seconds / first, used, worst_residual(*laplacian, found), found.values.maxCoeff(),
                truncation(surface, *laplacian, found));
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  int m = 200, repeats = 1;
  bool peers = false, exactly = false;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--peers") == 0) {
      peers = true;
    } else if (std::strcmp(argv[i], "--exactly") == 0) {
      exactly = true;
    } else if (std::strcmp(argv[i], "--m") == 0 && i + 1 < argc) {
      m = std::atoi(argv[++i]);
    } else if (std::strcmp(argv[i], "--repeat") == 0 && i + 1 < argc) {
      repeats = std::max(1, std::atoi(argv[++i]));
    } else {
      compare(argv[i], m, repeats, peers, exactly);
    }
  }
}
