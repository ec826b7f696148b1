// SPDX-License-Identifier: MIT
import { connect, type Broker, type Stream } from '../client/client.js';
import { checkedName } from '../client/url.js';
import { Playout } from '../core/playout.js';
import { Stage } from '../view/stage.js';
import { View } from '../view/view.js';
import { command, part } from './parts.js';
import { hideToken, pageOf, placeOf } from './place.js';
import { StreamPage } from './stream_page.js';

// The page that a broker serves: /: its streams; /NAME: one of them.

async function open(): Promise<void> {
  const place = placeOf(new URL(location.href), import.meta.url);
  hideToken(place);
  if (place.query.has('file')) return location.replace(new URL(`show.html${location.search}`, import.meta.url));
  // Of the page, not of the stream.
  const compared = place.query.get('compare'), group = place.query.get('sync');
  const asked = [...place.query].filter(([name]) => !/^(compare|sync)$/.test(name));
  const profile = place.stream === '' || asked.length === 0 ? {} : (await import('../client/query.js')).profileIn(new URLSearchParams(asked));
  const synced = group === null ? undefined : await import('./sync.js'), sync = synced?.checkedGroup(group!);
  let stream: Stream | undefined;
  const watch = (broker: Broker): void => {
    if (place.stream === '') return;
    // The broker names the surface in the page where anybody may see it; Firefox gives its worker what the page has loaded; Chromium asks the broker again.
    const surface = document.querySelector<HTMLLinkElement>('[href*="v1/assets/"]')?.href;
    if (surface) void fetch(surface).catch(() => {});
    stream = broker.watch(checkedName(place.stream), { profile, expects: surface?.slice(-64), sync });
  };
  const connecting = connect(place.base, { token: place.token, meanwhile: watch }), staging = Stage.make(connecting.then(({ module }) => module));
  staging.catch(() => {});  // Said where it is awaited.
  const broker = await connecting;
  if (!stream) {
    const [{ ListPage }, stage] = await Promise.all([import('./list_page.js'), staging.catch(() => undefined)]);
    return new ListPage(place, broker, stage, { View, part, command, pageOf }).run();
  }
  const stage = await staging;
  if (synced) stream.playout = synced.inStep(new Playout(stage.core), broker, stream);
  const { view } = new StreamPage(place, broker, stage, stream);
  if (compared !== null) document.querySelector('main')!.append((await import('./compare.js')).compare(view, broker, compared, profile, part));
}

open().catch(async (error: unknown) => {
  console.error(error);
  const { Note } = await import('./note.js'), note = new Note(part('section', { class: 'note' }), { part, command });
  note.fail('The page cannot start', error instanceof WebAssembly.CompileError ? 'this browser is too old for it: it takes WebAssembly with SIMD' : (error as Error).message);
  document.body.replaceChildren(part('main', {}, part('h1', { class: 'unseen' }, 'Eigencast'), note.element));
});
