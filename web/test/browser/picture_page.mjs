// SPDX-License-Identifier: MIT
//
// What the page of pictures runs: one stream in a canvas of its own, by what `eigencast` exports. The test asks for
// pictures by window.take(how, style), how: '', 'rebuilt' (the style takes another surface), 'flipped' (normals) or
// 'shadowless'.
import { connect } from '/v1/web/eigencast.js';
import { Stage, View } from '/v1/web/view.js';

const name = new URLSearchParams(location.search).get('stream');
const broker = await connect(location.origin);
const stage = await Stage.make(broker.module, { picturesPerSecond: 0 });
const stream = broker.watch(name, { profile: { rate: 'raw' } });
const canvas = document.body.appendChild(document.createElement('canvas'));
canvas.className = 'picture';
const view = new View(stage, canvas, stream);
view.live.playout = { mode: 'latest' };
window.view = view;
window.stage = stage;

/** Undone by what it returns. */
const TAMPERINGS = {
  flipped() {
    const rebuild = stream.rebuild.bind(stream);
    stream.rebuild = async (asked) => {
      const made = await rebuild(asked);
      return { ...made, normals: made.normals.map((part) => -part) };
    };
    view.live.forgetDrawn();
    return () => {
      stream.rebuild = rebuild;
      view.live.forgetDrawn();
    };
  },
  shadowless() {
    const { gl } = stage, draw = gl.drawElements.bind(gl);
    gl.drawElements = (...words) => (gl.getParameter(gl.VIEWPORT)[2] === 512 ? undefined : draw(...words));
    return () => (gl.drawElements = draw);
  },
};
const nextPicture = async () => {
  const { rebuilt } = view.live.drawn, drawn = view.drawn;
  view.invalidate();
  while (view.drawn === drawn || view.live.drawn.rebuilt === rebuilt && window.waitsForRebuilt) await new Promise((resolve) => setTimeout(resolve, 10));
};

/** {shown: capture time, png: base64} */
window.take = async (how = '', style = {}) => {
  const before = view.style;
  view.setStyle(style);
  window.waitsForRebuilt = how === 'flipped' || how === 'rebuilt';
  const undo = TAMPERINGS[how]?.();
  await nextPicture();
  const blob = await view.picture(view.style.wall), shown = String(view.live.shownUs);
  undo?.();
  view.setStyle(before);
  await nextPicture();
  window.waitsForRebuilt = false;
  const bytes = new Uint8Array(await blob.arrayBuffer());
  return { shown, png: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join('')) };
};
window.isReady = () => stream.surface?.isComplete && view.live.shownUs !== undefined && view.vertices === stream.surface.facts.vertexCount && !view.live.drawn.rebuilt.isMoving;
