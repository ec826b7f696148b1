#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a picture of a surface of 262,144 faces costs a viewer, part by part: decode, reconstruct, normals, upload, draw; rebuilt on the
processor and on the GPU.

The surface is a torus with waves running over it. A viewer watches it over a broker, at full detail and at a tenth, in a large and in a
small picture. Poses come slowly, so that nobody waits for anybody. The surface is downloaded once before anything is measured: what a
viewer rebuilds while it arrives is less than the surface. --prepare only bakes, which takes minutes; later runs find it.
"""
import json

from common import Stage, np, parser, write_table

AROUND, ACROSS, FRAMES = 512, 256, 12
PARTS = ("decode", "reconstruct", "normals", "upload", "draw", "work")
VIEWS = ((1, "1280x720"), (1, "128x72"), (0.1, "128x72"))


def write_clip(folder):
    folder.mkdir()
    i, j = np.meshgrid(np.arange(AROUND), np.arange(ACROSS), indexing="ij")
    a, b = 2 * np.pi * i / AROUND, 2 * np.pi * j / ACROSS

    def frame(t):
        r = 0.35 + 0.06 * np.sin(3 * a + t) + 0.03 * np.cos(5 * b - t)
        ring = 1 + 0.1 * np.cos(2 * a - t) + r * np.cos(b)
        return np.stack([ring * np.cos(a), r * np.sin(b) + 0.15 * np.sin(2 * a + t), ring * np.sin(a)], -1).reshape(-1, 3)

    def number(x, y):
        return (x % AROUND) * ACROSS + y % ACROSS

    np.save(folder / "vertices.npy", np.array([frame(2 * np.pi * k / FRAMES) for k in range(FRAMES)], dtype=np.float32))
    corners = [[number(i, j), number(i, j + 1), number(i + 1, j)], [number(i + 1, j), number(i, j + 1), number(i + 1, j + 1)]]
    np.save(folder / "faces.npy", np.concatenate([np.stack(c, -1).reshape(-1, 3) for c in corners]).astype(np.int32))
    return folder / "vertices.npy"


def watch(stage, lod, size, reconstruct, frames, options):
    report = stage.folder / f"{lod}-{size}-{reconstruct}-{frames}.json"
    stage.wait(stage.start("eigencast-client", stage.url("torus") + "?rate=raw", "--headless", "--size", size, "--lod", lod,
                           "--reconstruct", reconstruct, "--frames", frames, "--duration", options.seconds, "--wait", 60,
                           "--cache", stage.folder / "viewer", "--json", report), 200)
    return json.loads(report.read_text())


def measured(stage, lod, size, reconstruct, options):
    report = watch(stage, lod, size, reconstruct, options.frames, options)
    assert report["surfaces"][0]["rebuilt"] == reconstruct
    poses, rebuilt = report["frames_out"]["poses_shown"], report["frame_time_us"]["reconstruct"]["count"]
    # Medians bear a few pictures of less than the surface, not many.
    if report["asset_bytes"]["downloaded"] or rebuilt - poses > poses / 4 or report["lod"]["vertices"] < round(lod * report["lod"]["of"]) - 1:
        raise SystemExit(f"{poses} poses, {rebuilt} rebuilds, {report['asset_bytes']['downloaded']} bytes downloaded, {report['lod']['vertices']} "
                         "vertices: the surface was not there when this was measured")
    return report


def main():
    p = parser(__doc__)
    p.add_argument("--frames", type=int, default=18, help="pictures of each run; of few too many are of a surface that is still being read")
    p.add_argument("--seconds", type=float, default=20, help="at most, of each run")
    p.add_argument("--prepare", action="store_true", help="bake, then end")
    options = p.parse_args()
    table = []
    with Stage(options) as stage:
        clip = write_clip(stage.folder / "torus")
        stage.wait(stage.start("eigencast-sender", "--no-progress", "bake", clip), 1800)
        if options.prepare:
            return
        stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip, "--rate", 2, "--speed", 1 / 15, "--to", stage.url("torus"))
        first = watch(stage, 0.02, "64x36", "cpu", 6, options)
        if first["asset_bytes"]["downloaded"] + first["asset_bytes"]["cached"] < first["asset_bytes"]["total"]:
            raise SystemExit("the surface did not arrive in time; give --seconds more")
        for lod, size in VIEWS:
            for reconstruct in ("cpu", "gpu"):
                report = measured(stage, lod, size, reconstruct, options)
                costs = report["frame_time_us"]
                table.append([f"{report['lod']['vertices']:,}", f"{report['lod']['faces']:,}", size, reconstruct, report["frames_out"]["drawn"],
                              *(f"{costs[part]['p50'] / 1000:.2f}" for part in PARTS), report["picture"]["device"]])
    write_table(options, "frame_cost",
                ["vertices", "faces", "picture", "rebuilt on", "drawn", *(f"{part} ms" for part in PARTS), "drawn by"], table)


if __name__ == "__main__":
    main()
