// SPDX-License-Identifier: MIT
import { COLOUR_MAPS } from '../view/style.js';
import type { View } from '../view/view.js';
import { PLAYOUT_MODES } from '../core/playout.js';

/** What keys and buttons change. */
export interface Desk {
  view: View;
  isTurning: boolean;
  hasFigures: boolean;
  hasLegend: boolean;
  say(text: string): void;
  isRecording: boolean;
  screenshot(wall: boolean): void;
  copyLink(): void;
  fullScreen(): void;
  help(): void;
}
export interface Command {
  /** As KeyboardEvent.key has them; the first is shown. Letters in capitals. */
  keys: string[];
  /** For the help, and the name of its button. */
  does: string;
  /** Lines in a square of 24: it has a button. */
  icon?: string;
  apply(desk: Desk): void;
  /** Of a switch: where it is. */
  isOn?(desk: Desk): boolean;
  /** For the help: where it is. */
  state?(desk: Desk): string;
}

function toggle(name: 'edges' | 'wireframe' | 'points' | 'grid' | 'axes', does: string, key: string, icon?: string): Command {
  return {
    keys: [key], does, ...(icon === undefined ? {} : { icon }), apply: ({ view }) => view.setStyle({ [name]: !view.style[name] }),
    isOn: ({ view }) => view.style[name],
  };
}
function nextColour({ view }: Desk): void {
  const offered = view.colourings;
  view.setStyle({ colour: offered[(offered.indexOf(view.style.colour) + 1) % offered.length]! });
}
function nextMap({ view }: Desk): void {
  view.setStyle({ colourMap: COLOUR_MAPS[(COLOUR_MAPS.indexOf(view.style.colourMap) + 1) % COLOUR_MAPS.length]! });
}
function nextPlayout({ view, say }: Desk): void {
  const mode = PLAYOUT_MODES[(PLAYOUT_MODES.indexOf(view.live.playout.mode) + 1) % PLAYOUT_MODES.length]!;
  view.live.playout = { mode };
  say(`motion between arrivals: ${mode}`);
}

/** The native client's keys (client/viewer_state.cpp), as far as the page has what they do; its others are free there. */
export const COMMANDS: Command[] = [
  {
    keys: [' '], does: 'pause', icon: 'M8 5v14M16 5v14', isOn: ({ view }) => view.live.isPaused,
    apply: ({ view }) => (view.live.isPaused = !view.live.isPaused),
  },
  { keys: ['End'], does: 'to the live pose', apply: ({ view }) => (view.live.isPaused = false) },
  {
    keys: ['R', 'Home'], does: 'reset the camera', icon: 'M4 11l8-7 8 7M6 10v9h12v-9',
    apply: ({ view }) => (view.camera.home(), view.invalidate()),
  },
  {
    keys: ['V'], does: 'what colours say', icon: 'M12 3a9 9 0 1 0 0 18c2 0 1-3 3-3h3a3 3 0 0 0 3-3c0-7-4-12-9-12M8 10h.1M12 7h.1M16 10h.1',
    apply: nextColour, state: ({ view }) => view.style.colour,
  },
  { keys: ['C'], does: 'colour map', apply: nextMap, state: ({ view }) => view.style.colourMap },
  { keys: ['B'], does: 'its legend', apply: (desk) => (desk.hasLegend = !desk.hasLegend), isOn: ({ hasLegend }) => hasLegend },
  toggle('edges', 'edges', 'E', 'M12 3l9 16H3zM12 3v16M7.5 11l9 0'),
  toggle('wireframe', 'wireframe', 'W'),
  toggle('points', 'points', 'P'),
  toggle('grid', 'ground grid', 'G'),
  toggle('axes', 'axes', 'X'),
  { keys: ['U'], does: 'up axis', apply: ({ view }) => view.nextUp(), state: ({ view }) => view.camera.up },
  {
    keys: ['+', '='], does: 'finer, at most', apply: ({ view }) => view.finer(), state: ({ view }) => `${Number((100 * view.lod).toPrecision(3))} %`,
  },
  { keys: ['-'], does: 'coarser', apply: ({ view }) => view.coarser() },
  { keys: ['M'], does: 'motion between arrivals', apply: nextPlayout, state: ({ view }) => view.live.playout.mode },
  { keys: ['Y'], does: 'turntable', apply: (desk) => (desk.isTurning = !desk.isTurning), isOn: ({ isTurning }) => isTurning },
  {
    keys: ['F'], does: 'figures', icon: 'M4 20V4M4 20h16M8 16v-4M12 16V8M16 16v-6', apply: (desk) => (desk.hasFigures = !desk.hasFigures),
    isOn: ({ hasFigures }) => hasFigures,
  },
  { keys: ['S', 'F12'], does: 'screenshot', icon: 'M4 8h3l2-3h6l2 3h3v11H4zM12 10a3 3 0 1 0 0 6 3 3 0 0 0 0-6', apply: (desk) => desk.screenshot(true) },
  { keys: ['Shift+S'], does: 'screenshot without background', apply: (desk) => desk.screenshot(false) },
  {
    keys: ['K'], does: 'record a film', icon: 'M12 5a7 7 0 1 0 0 14a7 7 0 0 0 0-14M12 10a2 2 0 1 0 0 4a2 2 0 0 0 0-4', apply: (desk) => (desk.isRecording = !desk.isRecording),
    isOn: ({ isRecording }) => isRecording,
  },
  {
    keys: ['I'], does: 'copy the link to this view', icon: 'M10 14a4 4 0 0 0 6 0l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6 0l-3 3a4 4 0 0 0 6 6l1-1',
    apply: (desk) => desk.copyLink(),
  },
  { keys: ['Enter'], does: 'full screen', icon: 'M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5', apply: (desk) => desk.fullScreen() },
  { keys: ['H', 'F1', '?'], does: 'this help', icon: 'M9 9a3 3 0 1 1 4 3c-1 .5-1 1-1 2M12 17.5h.01', apply: (desk) => desk.help() },
];

export function commandFor({ key, shiftKey, ctrlKey, altKey, metaKey }: KeyboardEvent, commands = COMMANDS): Command | undefined {
  if (ctrlKey || altKey || metaKey) return undefined;
  const name = key.length === 1 ? key.toUpperCase() : key;
  const wanted = shiftKey && name === 'S' ? 'Shift+S' : name;
  return commands.find(({ keys }) => keys.includes(wanted));
}
