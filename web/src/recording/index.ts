// SPDX-License-Identifier: MIT
/**
 * A page in one file that plays a recording: ?file=URL, by Range, else the one inside it, or one that is dropped on it or
 * chosen. It speaks to no broker.
 */
import core from 'inline:eigencast-core.wasm';
import levels from 'inline:eigencast-levels.wasm';
import worker from 'inline:player.js';
import { defaults } from '../client/defaults.js';
import { bytesFromBase64, inflated } from '../core/base64.js';
import { COMMANDS, type Command } from '../page/commands.js';
import { icon, part } from '../page/parts.js';
import { placeOf } from '../page/place.js';
import { StreamPage } from '../page/stream_page.js';
import { Stage } from '../view/stage.js';
import { barOf, playerCommands } from './bar.js';
import { openRecording } from './player.js';

/** Of base64, whose text is decoded in pieces. */
const PIECE = 1 << 20;

defaults.core = inflated(core);
defaults.levels = inflated(levels);
defaults.worker = URL.createObjectURL(new Blob([worker], { type: 'text/javascript' }));

function inside(): Blob | undefined {
  const said = document.getElementById('recording')?.textContent ?? '', text = said.startsWith('{') ? '' : said;
  const pieces = Array.from({ length: Math.ceil(text.length / PIECE) }, (_, i) => bytesFromBase64(text.slice(i * PIECE, (i + 1) * PIECE)));
  return pieces.length > 0 ? new Blob(pieces) : undefined;
}

async function play(what: Blob | string): Promise<void> {
  const { stream, player, module } = await openRecording(what, new Worker(defaults.worker)), stage = await Stage.make(module);
  const address = new URL(location.href), folder = address.href.replace(/[^/]*([?#].*)?$/, '');
  const place = { ...placeOf(address, `${folder}v1/web/`), base: folder.slice(0, -1), stream: address.pathname.split('/').at(-1)!, token: '' };
  const keys: Command[] = [
    ...playerCommands(player),
    { keys: ['End'], does: 'to the last pose', apply: () => ((player.isPlaying = false), player.seek(player.durationUs)) },
    { keys: ['L'], does: 'again and again', apply: () => (player.isLooping = !player.isLooping), isOn: () => player.isLooping },
  ];
  const free = new Set(['M', ...keys.flatMap((command) => command.keys)]);
  new StreamPage(place, { retryNow: () => {} }, stage, stream, [...keys, ...COMMANDS.filter((command) => !free.has(command.keys[0]!))]);
  document.querySelector('.viewer')!.append(barOf(player, part, icon));
}

function fail(error: Error): void {
  console.error(error);
  ask(`The recording cannot be shown: ${error.message}`);
}
function open(what: Blob | string): void {
  ask('Opening the recording ...');
  play(what).catch(fail);
}
function ask(said: string): void {
  const file = part('input', { type: 'file', accept: '.ecrec', 'aria-label': 'Recording' });
  file.addEventListener('change', () => file.files?.[0] && open(file.files[0]));
  document.body.replaceChildren(part('main', { class: 'list' }, part('h1', {}, 'Eigencast'), part('p', { role: 'status' }, said), part('p', {}, 'Drop a recording (.ecrec) here, or choose one: ', file)));
}

document.documentElement.classList.add('recorded');
document.addEventListener('dragover', (event) => event.preventDefault());
document.addEventListener('drop', (event) => {
  event.preventDefault();
  const file = event.dataTransfer?.files[0];
  if (file && !document.querySelector('.viewer')) open(file);
});
const wanted = new URLSearchParams(location.search).get('file') ?? inside();
if (wanted) open(typeof wanted === 'string' ? new URL(wanted, location.href).href : wanted);
else ask('');
