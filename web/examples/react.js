// A stream as a component: react.html?stream=https://host/lab/horse
import { createElement, StrictMode, useState } from 'react';
import { createRoot } from 'react-dom/client';
import 'eigencast/parts';
import { EigencastView } from 'eigencast/react';

function Page({ src }) {
  const [detail, setDetail] = useState('connecting');
  document.title = detail;
  return createElement(EigencastView, { src, colour: 'own', onStatus: (status) => setDetail(status.detail), onError: (error) => setDetail(error.message) });
}

const url = new URLSearchParams(location.search).get('stream') ?? 'http://localhost:7490/demo';
const root = createRoot(document.querySelector('#root'));
root.render(createElement(StrictMode, null, createElement(Page, { src: url })));
window.shown = { root };  // To play with in the console.
