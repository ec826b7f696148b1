// SPDX-License-Identifier: MIT
import { connect, profileIn } from '../client/client.js';
import { checkedName } from '../client/url.js';
import { Stage } from '../view/stage.js';
import { View } from '../view/view.js';
import { Note } from './note.js';
import { command, part } from './parts.js';
import { hideToken, pageOf, placeOf } from './place.js';
import { StreamPage } from './stream_page.js';

// The page that a broker serves: /: its streams; /NAME: one of them.

async function open(): Promise<void> {
  const place = placeOf(new URL(location.href), import.meta.url);
  hideToken(place);
  const connecting = connect(place.base, { token: place.token }), staging = Stage.make(connecting.then(({ module }) => module));
  staging.catch(() => {});  // Said where it is awaited.
  const broker = await connecting;
  if (place.stream === '') {
    const [{ ListPage }, stage] = await Promise.all([import('./list_page.js'), staging.catch(() => undefined)]);
    return new ListPage(place, broker, stage, { View, part, command, pageOf }).run();
  }
  const stream = broker.watch(checkedName(place.stream), { profile: profileIn(place.query) });  // It arrives meanwhile.
  new StreamPage(place, broker, await staging, stream);
}

open().catch((error: unknown) => {
  const note = new Note();
  note.fail('The page cannot start', error instanceof WebAssembly.CompileError ? 'this browser is too old for it: it takes WebAssembly with SIMD' : (error as Error).message);
  document.body.replaceChildren(note.element);
  console.error(error);
});
