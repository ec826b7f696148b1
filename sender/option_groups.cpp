// SPDX-License-Identifier: MIT
#include "sender/option_groups.h"

#include <cmath>
#include <cstdlib>

#include "sdk/asset_cache.h"

namespace eigencast {

CLI::Validator positive() {
  return CLI::Validator(
      [](std::string& text) -> std::string {
        char* end = nullptr;
        const double value = std::strtod(text.c_str(), &end);
        const bool good = end != text.c_str() && *end == '\0' && std::isfinite(value) && value > 0;
        return good ? std::string() : "give a number above 0, not " + text;
      },
      "");
}

void add_clip_options(CLI::App& app, SourceOptions& source) {
  app.option_defaults()->group("The clip");
  app.add_option("input", source.input,
                 "built-in shape (heart, bar, torus, sphere, ...), clip.npy, .pc2, .mdd, .glb or .gltf, "
                 "recording.ecrec, folder or 'glob' of "
                 "OBJ/PLY/OFF/STL/XYZ, or one file")
      ->required();
  app.add_option("--rest", source.rest, "file of the rest pose (default: beside the clip, or its first frame)");
  app.add_option("--faces", source.faces, "faces of a .npy clip (default: faces.npy beside it)");
  app.add_option("--animation", source.animation, "name or number of a glTF file's animation (default: the first)");
  app.add_option("--sample-rate", source.sample_rate_hz,
                 "poses a second that a glTF animation or a recording is sampled at (default: 30; a recording's own)")
      ->check(CLI::Range(0.1, 1000.0));
}

template <typename Names, typename Value>
bool find(const Names& names, const std::string& text, Value& value) {
  const auto found = names.find(text);
  return found && (value = *found, true);
}

/// What CLI11 finds by the enumeration's namespace.
bool lexical_cast(const std::string& text, BasisKind& kind) {
  return find(kBasisNames, text, kind);
}
bool lexical_cast(const std::string& text, EigenSolver& solver) {
  return find(kSolverNames, text, solver);
}
bool lexical_cast(const std::string& text, PointsOperator& points) {
  return find(kPointsOperatorNames, text, points);
}

bool lexical_cast(const std::string& text, MemoryUse& use) {
  return find(kMemoryUseNames, text, use);
}
bool lexical_cast(const std::string& text, LearnUse& use) {
  return find(kLearnUseNames, text, use);
}

template <typename Names>
CLI::Validator one_of(const Names& names) {
  return CLI::IsMember(std::vector<std::string>(names.names.begin(), names.names.end()));
}

template <typename Bases, typename Ranks>
void add_basis_options(CLI::App& app, Bases& bases, Ranks& ranks, SourceOptions& source) {
  app.option_defaults()->group("The basis");
  app.add_option(
         "--basis", bases,
         "augmented or harmonic, for any motion; rig, of a glTF file's skin and morph targets, or cage, whose motion "
         "they hold exactly; pca, learned from the clip")
      ->check(one_of(kBasisNames))
      ->delimiter(',')
      ->type_name("TEXT")
      ->default_str(std::string(name_of(BasisKind::kAugmented)));
  app.add_option("--solver", source.solver,
                 "of augmented and harmonic bases: lanczos, or spectra, a second opinion for up to 20,000 vertices")
      ->check(one_of(kSolverNames))
      ->type_name("TEXT")
      ->default_str(std::string(kSolverNames[EigenSolver::kLanczos]));
  CLI::Option* rank = app.add_option("-r,--rank,--r", ranks,
                                     "coefficients per axis (default: 200; pca: 50; rig, cage: all that there are)")
                          ->check(CLI::Range(4, 4096))
                          ->delimiter(',');
  CLI::Option* target = app.add_option("--target-error", source.target_error,
                                       "instead of --rank: the fewest bits at this rms error of basis and coding, of "
                                       "the diagonal")
                            ->check(CLI::Range(1e-9, 1.0))
                            ->excludes(rank);
  app.add_option("--quality", source.quality,
                 "likewise: at the error of 200 coefficients that are coded to within 1e-3, divided by this")
      ->check(CLI::Range(0.01, 100.0))
      ->excludes(rank)
      ->excludes(target);
  app.add_option(
         "--bitrate", source.bitrate_kbit,
         "likewise: the least error at this many kbit/s; streams keep to it by coarser levels, then fewer bands")
      ->check(positive());
  app.add_option("--poses", source.poses,
                 "clip that bases are judged by (default: the input; of a single pose: deformations of it)")
      ->excludes(rank);
}

void add_asset_options(CLI::App& app, SourceOptions& source) {
  app.option_defaults()->group("The asset");
  source.cache_dir = default_cache_dir();
  app.add_option(
         "--asset-error", source.asset_error,
         "what storing the basis may move vertices by, of the diagonal; 0: 32-bit floats, a large asset (default: "
         "1e-4; rig, cage: 0)")
      ->check(CLI::Range(0.0, 0.1));
  app.add_option(
         "--points-operator", source.points_operator,
         "of point clouds: delaunay, or pb-mhb, the heat kernel between points, which takes some five times as long")
      ->check(one_of(kPointsOperatorNames))
      ->type_name("TEXT")
      ->default_str(std::string(kPointsOperatorNames[PointsOperator::kLocalDelaunay]));
  app.add_flag("--delaunay", source.delaunay,
               "of meshes: take the operator of Delaunay triangles, as is done where an edge has three or more faces: "
               "for long and thin faces");
  app.add_option("--detail", source.detail,
                 "what a harmonic or pca basis leaves out of the rest pose, put back by viewers: along normals (the "
                 "paper's way) or in frames that turn with the surface, with an asset "
                 "three times as large (default: harmonic: frames, else none)")
      ->check(CLI::IsMember({"none", "normal", "frames"}));
  CLI::Option* cage = app.add_option("--cage", source.cage.file, "closed mesh around the model (default: one is made)");
  app.add_option("--cage-resolution", source.cage.resolution, "of a cage that is made: cubes along the longest side")
      ->check(CLI::Range(1, 64))
      ->capture_default_str()
      ->excludes(cage);
  app.add_option("--coordinates", source.cage.coordinates,
                 "of the cage: green keeps shapes; mean-value is affine, outside too")
      ->check(CLI::IsMember({"green", "mean-value"}))
      ->capture_default_str();
  app.add_option("--name", source.name, "name of the surface, for people");
  app.add_flag("--any-order", source.any_order,
               "take poses whose vertices seem to be in another order than the faces'; refused without");
  app.add_option("--cache", source.cache_dir,
                 "folder where bakes are kept, up to $EIGENCAST_CACHE_BYTES (4 GiB); '' for none (default: "
                 "~/.cache/eigencast)")
      ->envname("EIGENCAST_CACHE");
}

void add_bake_options(CLI::App& app, SourceOptions& source) {
  add_basis_options(app, source.basis, source.rank, source);
  add_asset_options(app, source);
}

void add_source_options(CLI::App& app, SourceOptions& source) {
  add_clip_options(app, source);
  add_bake_options(app, source);
}

template <typename Errors>
CLI::Option* add_codec_options(CLI::App& app, std::string& codec, Errors& errors) {
  app.option_defaults()->group("Coding of poses");
  app.add_option("--codec", codec, "quantised, float32 or float64")
      ->check(CLI::IsMember({"quantised", "float32", "float64"}))
      ->capture_default_str();
  return app
      .add_option("--error", errors,
                  "vertex error that quantising may add, in model units (default: 1e-3 of the diagonal)")
      ->check(positive())
      ->delimiter(',');
}

void add_target_options(CLI::App& app, TargetOptions& target) {
  app.option_defaults()->group("Where to");
  app.add_option("--to", target.url,
                 "http://host[:port]/stream (https:// for TLS; http://a,b/stream: the brokers a and b of a cluster in "
                 "turn), or a stream at the context's broker (default: the "
                 "input's name, there or at this machine's broker)")
      ->envname("EIGENCAST_URL");
  add_credential_options(app, target.credentials)->envname("EIGENCAST_TOKEN");
  app.add_option("--context", target.context, "broker by name, see context (default: the current one)")
      ->envname("EIGENCAST_CONTEXT");
}

void add_memory_option(CLI::App& app, TargetOptions& target) {
  app.option_defaults()->group("Coding of poses");
  app.add_option(
         "--memory", target.memory,
         "poses that all hold, so that motion that comes again takes a fraction of the bits: auto, as far as that "
         "pays; on, all that is new at once, of motion that will come again; off")
      ->check(one_of(kMemoryUseNames))
      ->type_name("TEXT")
      ->default_str(std::string(kMemoryUseNames[target.memory]));
}

void add_coding_options(CLI::App& app, TargetOptions& target) {
  add_codec_options(app, target.codec, target.error);
  add_memory_option(app, target);
  app.add_option("--learn", target.learn,
                 "columns of what the basis misses, learnt from the first seconds, for less error at as many bits: "
                 "auto, where viewers soon have saved their download; on, wherever there are some; off")
      ->check(one_of(kLearnUseNames))
      ->type_name("TEXT")
      ->default_str(std::string(kLearnUseNames[target.learn]));
  app.add_option("--still", target.still_s,
                 "while the surface rests (within 1.5 --error), send it only every so many seconds")
      ->check(CLI::Range(0.1, 3600.0));
}

template void add_basis_options(CLI::App&, BasisKind&, int&, SourceOptions&);
template void add_basis_options(CLI::App&, std::vector<BasisKind>&, std::vector<int>&, SourceOptions&);
template CLI::Option* add_codec_options(CLI::App&, std::string&, double&);
template CLI::Option* add_codec_options(CLI::App&, std::string&, std::vector<double>&);

}  // namespace eigencast
