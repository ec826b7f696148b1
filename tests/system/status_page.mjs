// SPDX-License-Identifier: MIT
// Runs the script of the broker's status page, twice as it refreshes, in a document of elements that only hold text, and
// prints what a reader would see: the text of each element that has an id, rows and cells of tables as arrays.
//
// Usage: node status_page.mjs http://127.0.0.1:ADMIN_PORT/
const url = process.argv[2];
const page = await (await fetch(url)).text();
const code = page.match(/<script[^>]*>([\s\S]*)<\/script>/)[1];
const element = () => ({
  textContent: '',
  className: '',
  children: [],
  append(child) { this.children.push(child); },
  replaceChildren(...children) { this.children = children; },
});
const elements = Object.fromEntries([...page.matchAll(/ id="([a-z-]+)"/g)].map(found => [found[1], element()]));
const document = {createElement: element, getElementById: id => elements[id]};
let refreshes = 0;
await new Promise(done => {
  const later = refresh => ++refreshes < 2 ? setTimeout(refresh, 500) : done();
  new Function('document', 'fetch', 'setTimeout', code)(document, path => fetch(new URL(path, url)), later);
});
const seen = node => node.children.length > 0 ? node.children.map(seen) : node.textContent;
console.log(JSON.stringify(Object.fromEntries(Object.entries(elements).map(([id, node]) => [id, seen(node)]))));
