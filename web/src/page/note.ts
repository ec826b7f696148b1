// SPDX-License-Identifier: MIT
import type { Status } from '../client/subscription.js';

/** What the person can do about a state. */
export interface Remedies {
  retry(): void;
  /** The token that was typed. */
  token(token: string): void;
}

/** Of the page: what both had would be a file of its own. */
export interface Kit {
  part: typeof import('./parts.js').part;
  command: typeof import('./parts.js').command;
}

/** Where there is nothing to see yet: what is going on, why, and what to do. */
export class Note {
  readonly element: HTMLElement;
  readonly #kit: Kit;
  #said = '';

  constructor(element: HTMLElement, kit: Kit) {
    this.element = element;
    this.#kit = kit;
  }

  hide(): void {
    this.element.hidden = true;
    this.#said = '';
  }
  /** `where`: the stream's URL. Keeps what was typed while the state stays. */
  show(status: Status, where: string, remedies: Remedies): void {
    const { part, command } = this.#kit;
    this.element.hidden = false;
    const { state, detail } = status, asksForToken = state === 'refused' && /answered 40[13]/.test(detail);
    if (state === 'downloading') return this.#tell('downloading', () => this.#download(status), () => this.#progress(status));
    if (state === 'waiting') {
      return this.#tell('waiting', () => [
        part('h2', {}, 'Waiting for a sender'),
        part('p', {}, 'Nobody publishes this stream yet. It is shown here as soon as somebody does, for example by'),
        command(`eigencast-sender play heart --to ${where.replace(/^http/, 'ws')}`),
      ]);
    }
    if (state === 'refused') {
      return this.#tell(detail, () => [
        part('h2', {}, asksForToken ? 'This stream takes a token' : 'The stream cannot be shown'), part('p', {}, detail),
        ...(asksForToken ? [this.#tokenForm(remedies)] : [part('button', { class: 'button', type: 'button', onclick: remedies.retry }, 'Try again')]),
      ]);
    }
    this.#tell(`${state} ${detail}`, () => [
      part('h2', {}, state === 'lost' ? 'Connection lost' : 'Connecting'), part('p', {}, detail === '' ? state : detail),
      ...(/try in/.test(detail) ? [part('button', { class: 'button', type: 'button', onclick: remedies.retry }, 'Try now')] : []),
    ]);
  }
  /** What nothing can be done about from here. */
  fail(title: string, why: string): void {
    const { part } = this.#kit;
    this.element.hidden = false;
    this.#tell(why, () => [part('h2', {}, title), part('p', {}, why)]);
  }

  #tell(said: string, make: () => Node[], update = (): void => {}): void {
    if (said !== this.#said) this.element.replaceChildren(...make());
    this.#said = said;
    update();
  }
  #download(status: Status): Node[] {
    const { part } = this.#kit;
    return [part('h2', {}, 'Downloading the surface'), part('p', {}, status.detail), part('progress', { 'aria-label': 'Download' })];
  }
  #progress({ asset, detail }: Status): void {
    const bar = this.element.querySelector('progress')!, line = this.element.querySelector('p')!;
    if (asset.totalBytes > 0) [bar.max, bar.value] = [asset.totalBytes, asset.downloadedBytes];
    line.textContent = asset.totalBytes > 0 && detail === 'downloading the surface' ? textFromDownload(asset) : detail;
  }
  #tokenForm(remedies: Remedies): HTMLElement {
    const { part } = this.#kit;
    const input = part('input', { type: 'password', name: 'token', autocomplete: 'off', 'aria-label': 'Token', placeholder: 'Token' });
    const form = part('form', {}, input, part('button', { class: 'button' }, 'Use it'));
    form.addEventListener('submit', (event) => {
      event.preventDefault();
      if (input.value.trim() !== '') remedies.token(input.value.trim());
    });
    return form;
  }
}

/** "4.1 of 11.3 MB" */
function textFromDownload({ downloadedBytes, totalBytes }: Status['asset']): string {
  return `${(downloadedBytes / 1e6).toFixed(1)} of ${(totalBytes / 1e6).toFixed(1)} MB`;
}
