// SPDX-License-Identifier: MIT
import type { Command } from '../page/commands.js';
import type { icon as Icon, part as Part } from '../page/parts.js';

/** What is played: a recording, or what a broker keeps of a stream. Positions are microseconds since its start. */
export interface Played {
  readonly positionUs: number;
  readonly durationUs: number;
  isPlaying: boolean;
  speed: number;
  seek(timeUs: number): void;
  step(by: 1 | -1): void;
  /** Where it is, for people, instead of the position. */
  readonly says?: string;
}

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 10];
const SAID_MS = 100, STEP_S = 0.01;
const PLAY = 'M8 5l11 7-11 7z', PAUSE = 'M8 5v14M16 5v14';

const faster = (player: Played): number => SPEEDS.find((speed) => speed > player.speed) ?? player.speed;
const slower = (player: Played): number => SPEEDS.filter((speed) => speed < player.speed).at(-1) ?? player.speed;

/** The native client's keys. */
export function playerCommands(player: Played): Command[] {
  return [
    { keys: [' '], does: 'play, pause', apply: () => (player.isPlaying = !player.isPlaying), state: () => (player.isPlaying ? 'plays' : 'pauses') },
    { keys: [','], does: 'one pose back', apply: () => player.step(-1) },
    { keys: ['.'], does: 'one pose on', apply: () => player.step(1) },
    { keys: ['['], does: 'slower', apply: () => (player.speed = slower(player)), state: () => `${player.speed} times` },
    { keys: [']'], does: 'faster', apply: () => (player.speed = faster(player)) },
  ];
}

/** "1:02:03.4" */
export function textFromUs(us: number): string {
  const tenths = Math.floor(us / 100_000), seconds = Math.floor(tenths / 10), two = (value: number): string => String(value).padStart(2, '0');
  const hours = Math.floor(seconds / 3600), minutes = Math.floor(seconds / 60) % 60;
  return `${hours > 0 ? `${hours}:${two(minutes)}` : minutes}:${two(seconds % 60)}.${tenths % 10}`;
}

/** A button that plays and pauses, the position, which can be dragged, and how fast it goes; inside: more, in that order. */
export function barOf(player: Played, part: typeof Part, icon: typeof Icon, ...more: HTMLElement[]): HTMLElement {
  const play = part('button', { class: 'button', type: 'button', onclick: () => (player.isPlaying = !player.isPlaying, refresh()) });
  const position = part('input', { type: 'range', min: '0', step: String(STEP_S), 'aria-label': 'Position' });
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
  position.addEventListener('pointerup', () => position.blur());  // Keys are the page's again.
  function refresh(): void {
    if (player.isPlaying !== isPlaying) {
      isPlaying = player.isPlaying;
      play.replaceChildren(icon(isPlaying ? PAUSE : PLAY));
      play.setAttribute('aria-label', isPlaying ? 'Pause' : 'Play');
    }
    const text = player.says ?? `${textFromUs(player.positionUs)} / ${textFromUs(player.durationUs)}`;
    position.max = String(player.durationUs / 1e6);
    if (!isHeld) position.value = String(player.positionUs / 1e6);
    position.setAttribute('aria-valuetext', text);
    time.textContent = text;
    speed.textContent = `${player.speed}\u00d7`;
  }
  setInterval(refresh, SAID_MS);
  refresh();
  return part('div', { class: 'timeline', role: 'group', 'aria-label': 'Timeline' }, play, part('div', { class: 'track' }, position), time, speed, ...more);
}
