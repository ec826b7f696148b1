// SPDX-License-Identifier: MIT
import type { Command } from '../page/commands.js';
import { icon, part } from '../page/parts.js';
import { SPEEDS, type Player } from './player.js';

const SAID_MS = 100, STEP_S = 0.01;
const PLAY = 'M8 5l11 7-11 7z', PAUSE = 'M8 5v14M16 5v14';

const faster = (player: Player, by: 1 | -1): void => {
  player.speed = SPEEDS[Math.min(Math.max(SPEEDS.indexOf(player.speed) + by, 0), SPEEDS.length - 1)]!;
};

/** The native client's keys of files. */
export function playerCommands(player: Player): Command[] {
  return [
    { keys: [' '], does: 'play, pause', apply: () => (player.isPlaying = !player.isPlaying), state: () => (player.isPlaying ? 'plays' : 'pauses') },
    { keys: ['End'], does: 'to the last pose', apply: () => ((player.isPlaying = false), player.seek(player.durationUs)) },
    { keys: [','], does: 'one pose back', apply: () => player.step(-1) },
    { keys: ['.'], does: 'one pose on', apply: () => player.step(1) },
    { keys: ['['], does: 'slower', apply: () => faster(player, -1), state: () => `${player.speed} times` },
    { keys: [']'], does: 'faster', apply: () => faster(player, 1) },
    { keys: ['L'], does: 'again and again', apply: () => (player.isLooping = !player.isLooping), isOn: () => player.isLooping },
  ];
}

/** "1:02:03.4" */
export function textFromUs(us: number): string {
  const tenths = Math.floor(us / 100_000), seconds = Math.floor(tenths / 10), two = (value: number): string => String(value).padStart(2, '0');
  const hours = Math.floor(seconds / 3600), minutes = Math.floor(seconds / 60) % 60;
  return `${hours > 0 ? `${hours}:${two(minutes)}` : minutes}:${two(seconds % 60)}.${tenths % 10}`;
}

/** A button that plays and pauses, the position, which can be dragged, and how fast it goes. */
export function barOf(player: Player): HTMLElement {
  const seconds = player.durationUs / 1e6, length = textFromUs(player.durationUs);
  const play = part('button', { class: 'button', type: 'button', onclick: () => (player.isPlaying = !player.isPlaying, refresh()) });
  const position = part('input', { type: 'range', min: '0', max: String(seconds), step: String(STEP_S), 'aria-label': 'Position' });
  const time = part('span', { class: 'time' });
  const speed = part('button', { class: 'button', type: 'button', title: 'Speed', onclick: () => {
    player.speed = SPEEDS[(SPEEDS.indexOf(player.speed) + 1) % SPEEDS.length]!;
    refresh();
  } });
  let isPlaying: boolean | undefined, isHeld = false;
  position.addEventListener('input', () => (player.seek(1e6 * Number(position.value)), refresh()));
  // The bar is where it is dragged to, not where the player is meanwhile.
  position.addEventListener('pointerdown', () => (isHeld = true));
  for (const name of ['pointerup', 'pointercancel', 'change']) position.addEventListener(name, () => (isHeld = false));
  function refresh(): void {
    if (player.isPlaying !== isPlaying) {
      isPlaying = player.isPlaying;
      play.replaceChildren(icon(isPlaying ? PAUSE : PLAY));
      play.setAttribute('aria-label', isPlaying ? 'Pause' : 'Play');
    }
    const text = textFromUs(player.positionUs);
    if (!isHeld) position.value = String(player.positionUs / 1e6);
    position.setAttribute('aria-valuetext', text);
    time.textContent = `${text} / ${length}`;
    speed.textContent = `${player.speed}\u00d7`;
  }
  setInterval(refresh, SAID_MS);
  refresh();
  return part('div', { class: 'timeline', role: 'group', 'aria-label': 'Timeline' }, play, position, time, speed);
}
