// SPDX-License-Identifier: MIT
import { spawn } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { basename, join } from 'node:path';
import { until } from '../unit/fake_broker.mjs';

/** The folder with the programs; ends a test that has none as skipped. */
export const BIN = process.env.EIGENCAST_BIN;
if (!BIN || !existsSync(join(BIN, 'eigencast-broker'))) {
  console.log('EIGENCAST_BIN has no eigencast-broker');
  process.exit(77);
}

/** Programs of a test, and a folder that goes with them. */
export class Programs {
  folder = mkdtempSync(join(tmpdir(), 'eigencast-web-'));
  #children = new Set();
  #names = 0;

  start(program, ...words) {
    return this.#spawn(program, words, 'ignore');
  }
  #spawn(program, words, stdin) {
    const environment = { ...process.env, EIGENCAST_TOKEN: '', EIGENCAST_CACHE: process.env.EIGENCAST_CACHE ?? join(this.folder, 'cache') };
    const child = spawn(join(BIN, program), words, { stdio: [stdin, 'ignore', 'inherit'], env: environment });
    this.#children.add(child);
    child.ended = new Promise((resolve) => child.on('exit', (code) => (this.#children.delete(child), resolve(code))));
    child.stop = async (signal = 'SIGTERM') => {
      child.kill(signal);
      await child.ended;
    };
    return child;
  }
  /** A broker of its own; more: options. */
  async broker(port = 0, ...more) {
    const file = join(this.folder, `port${++this.#names}`), data = join(this.folder, `data${this.#names}`);
    const process = this.start('eigencast-broker', `--listen=127.0.0.1:${port}`, '--admin-listen=127.0.0.1:0', `--port-file=${file}`, `--data-dir=${data}`, '--log-level=error', ...more);
    const text = await until(() => existsSync(file) && /\n$/.test(readFileSync(file, 'utf8')) && readFileSync(file, 'utf8'), 'the port of the broker');
    return { ...process, stop: process.stop, port: Number(text.split(/\s/)[0]), data };
  }
  /** what: an input of `play`, and its options. */
  sender(broker, name, ...what) {
    return this.start('eigencast-sender', 'play', ...what, '--to', `ws://127.0.0.1:${broker.port}/${name}`, '--no-progress');
  }
  /** A bumpy ring that stands still in a pose of its own, live: 960 vertices times `finer` squared, with an image (a PNG), colours, or both. */
  ring(broker, name, image, isPainted = !image, finer = 1) {
    const AROUND = 48 * finer, ACROSS = 20 * finer, rest = [], posed = [], faces = [], uvs = [];
    for (let i = 0; i < AROUND; ++i) {
      for (let k = 0; k < ACROSS; ++k) {
        const u = (2 * Math.PI * i) / AROUND, v = (2 * Math.PI * k) / ACROSS, r = 0.35 + 0.08 * Math.sin(3 * u);
        const out = 1 + r * Math.cos(v), point = [out * Math.cos(u), r * Math.sin(v), out * Math.sin(u)];
        rest.push(point);
        posed.push(point[0], point[1] + 0.3 * point[0] * point[0], 1.2 * point[2]);
        const corner = (a, b) => `${((i + a) % AROUND) * ACROSS + ((k + b) % ACROSS) + 1}/${(i + a) * (ACROSS + 1) + k + b + 1}`;
        faces.push(`f ${corner(0, 0)} ${corner(0, 1)} ${corner(1, 1)}`, `f ${corner(0, 0)} ${corner(1, 1)} ${corner(1, 0)}`);
      }
    }
    for (let i = 0; i <= AROUND; ++i) for (let k = 0; k <= ACROSS; ++k) uvs.push(`vt ${i / AROUND} ${k / ACROSS}`);
    const base = join(this.folder, `ring${++this.#names}`), mesh = `${base}.obj`;
    const colours = (point) => (isPainted ? ` ${point.map((x) => 0.5 + 0.3 * x).join(' ')}` : '');
    writeFileSync(mesh, [...(image ? [`mtllib ${basename(base)}.mtl`] : []), ...rest.map((point) => `v ${point.join(' ')}${colours(point)}`), ...uvs, ...(image ? ['usemtl skin'] : []), ...faces, ''].join('\n'));
    if (image) {
      writeFileSync(`${base}.png`, image);
      writeFileSync(`${base}.mtl`, `newmtl skin\nmap_Kd ${basename(base)}.png\n`);
    }
    const sender = this.#spawn('eigencast-sender', ['pipe', '--mesh', mesh, '--rank', '48', '--to', `ws://127.0.0.1:${broker.port}/${name}`], 'pipe');
    sender.stdin.write(Buffer.from(Float32Array.from(posed).buffer));
    return sender;
  }
  /** A live ball of 1,500 points that is stretched in its pose, without colours. */
  cloud(broker, name) {
    const file = join(this.folder, `cloud${++this.#names}.xyz`), points = Array.from({ length: 1500 }, (_, i) => {
      const y = 1 - (2 * i + 1) / 1500, r = Math.sqrt(1 - y * y), turn = 2.399963 * i;
      return [r * Math.cos(turn), y, r * Math.sin(turn)];
    });
    writeFileSync(file, points.map((point) => point.join(' ')).join('\n'));
    const sender = this.#spawn('eigencast-sender', ['pipe', '--mesh', file, '--rank', '24', '--to', `ws://127.0.0.1:${broker.port}/${name}`], 'pipe');
    sender.stdin.write(Buffer.from(Float32Array.from(points.flatMap(([x, y, z]) => [1.2 * x, y, z])).buffer));
    return sender;
  }
  /** A live tube that sways, as its basis can, and folds, as a few columns that its stream learns can: tests/system/learn_test.py. */
  tube(broker, name) {
    const RINGS = 60, SIDES = 24, mesh = join(this.folder, `tube${++this.#names}.obj`), { cos, sin } = Math;
    const pose = (number) => Float32Array.from({ length: 3 * RINGS * SIDES }, (_, i) => {
      const t = 0.2 * number, vertex = Math.floor(i / 3), along = Math.floor(vertex / SIDES) / RINGS, around = (2 * Math.PI * (vertex % SIDES)) / SIDES;
      const radius = 0.2 + 0.02 * (sin(t) * cos(150 * along) + cos(1.7 * t) * sin(120 * along));
      return [along + 0.1 * sin(0.7 * t), radius * cos(around) + 0.2 * sin(3 * along + t), radius * sin(around)][i % 3];
    });
    const lines = Array.from({ length: RINGS * SIDES }, (_, v) => `v ${pose(0).subarray(3 * v, 3 * v + 3).join(' ')}`);
    for (let ring = 0; ring + 1 < RINGS; ++ring) {
      for (let side = 0; side < SIDES; ++side) {
        const [a, b] = [ring * SIDES + side + 1, ring * SIDES + ((side + 1) % SIDES) + 1];
        lines.push(`f ${a} ${a + SIDES} ${b + SIDES}`, `f ${a} ${b + SIDES} ${b}`);
      }
    }
    writeFileSync(mesh, `${lines.join('\n')}\n`);
    const to = `ws://127.0.0.1:${broker.port}/${name}`;
    const sender = this.#spawn('eigencast-sender', ['pipe', '--mesh', mesh, '--rank', '40', '--rate', '30', '--learn', 'on', '--memory', 'off', '--wait', '--to', to], 'pipe');
    let number = 0;
    const feed = () => {
      while (sender.stdin.write(Buffer.from(pose(number++).buffer)));
    };
    sender.stdin.on('drain', feed).on('error', () => {});
    feed();
    return sender;
  }
  stop() {
    for (const child of this.#children) child.kill('SIGKILL');
    rmSync(this.folder, { recursive: true, force: true, maxRetries: 5 });
  }
}
