// SPDX-License-Identifier: MIT
// MuJoCo's cloth falls on a ball; its skin is streamed: cloth_mujoco http://127.0.0.1:7490/cloth
#include <mujoco/mujoco.h>

#include <chrono>
#include <cstdio>
#include <cstring>
#include <eigencast/eigencast.hpp>
#include <exception>
#include <memory>
#include <thread>

constexpr char kModel[] = R"(<mujoco><option timestep="0.002"/><size njmax="5000" nconmax="1000"/><worldbody>
  <geom type="plane" size="2 2 0.1"/><geom type="sphere" size="0.3" pos="0 0 0.5" friction="2"/>
  <body name="B7_7" pos="0 0 0.85"><freejoint/>
    <composite type="cloth" count="15 15 1" spacing="0.06" flatinertia="0.01">
      <joint kind="main" damping="0.001"/><geom size="0.02"/><skin texcoord="false" inflate="0.01" subgrid="2"/>
    </composite></body></worldbody></mujoco>)";

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  const auto files = std::make_unique<mjVFS>();
  mj_defaultVFS(files.get());
  if (mj_makeEmptyFileVFS(files.get(), "cloth.xml", sizeof kModel - 1) != 0) return 1;
  std::memcpy(files->filedata[0], kModel, sizeof kModel - 1);
  char error[500] = "";
  mjModel* model = mj_loadXML("cloth.xml", files.get(), error, sizeof error);
  if (model == nullptr) return std::fprintf(stderr, "%s\n", error), 1;
  mjData* data = mj_makeData(model);
  mjvScene scene;
  mjvOption options;
  mjvCamera camera;
  mjv_defaultOption(&options);
  mjv_defaultCamera(&camera);
  mjv_defaultScene(&scene);
  mjv_makeScene(model, &scene, 1000);
  const std::span points(scene.skinvert, 3 * static_cast<std::size_t>(model->nskinvert));
  const std::span faces(reinterpret_cast<const std::uint32_t*>(model->skin_face), 3 * model->nskinface);
  try {
    eigencast::Stream stream(argv[1], {.z_up = true});
    constexpr int kPoses = 60;
    for (int pose = 0; pose < kPoses; ++pose) {
      mj_forward(model, data);
      mjv_updateScene(model, data, &options, nullptr, &camera, mjCAT_ALL, &scene);  // its skins, too
      (void)stream.send(points, faces);
      while (pose == 0 && stream.stats().subscribers == 0) {  // so that a viewer sees it from its beginning
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
      }
      while (data->time < (pose + 1) / 30.0) mj_step(model, data);
      std::this_thread::sleep_for(std::chrono::microseconds(33334));
    }
    std::printf("sent %d poses\n", kPoses);
  } catch (const std::exception& failure) {
    return std::fprintf(stderr, "%s\n", failure.what()), 1;
  }
  mjv_freeScene(&scene);
  mj_deleteData(data);
  mj_deleteModel(model);
}
