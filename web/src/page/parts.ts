// SPDX-License-Identifier: MIT

type Attributes = Record<string, string | boolean | (() => void)>;

/** An element; what begins with "on" is listened to, true and false are there and not there. */
export function part<Name extends keyof HTMLElementTagNameMap>(
  name: Name, attributes: Attributes = {}, ...inside: (Node | string)[]
): HTMLElementTagNameMap[Name] {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === 'function') made.addEventListener(key.slice(2), value);
    else if (value !== false) made.setAttribute(key, value === true ? '' : value);
  }
  made.append(...inside);
  return made;
}

/** Lines in a square of 24. */
export function icon(path: string): SVGSVGElement {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg'), line = document.createElementNS(svg.namespaceURI, 'path');
  svg.setAttribute('viewBox', '0 0 24 24');
  svg.setAttribute('aria-hidden', 'true');
  line.setAttribute('d', path);
  svg.append(line);
  return svg as SVGSVGElement;
}

/** To the clipboard, which pages of http:// have only by a selection. */
export async function copy(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = part('textarea', { class: 'unseen' }, text);
    (document.querySelector('dialog[open]') ?? document.body).append(area);
    area.select();
    const done = document.execCommand('copy');
    area.remove();
    return done;
  }
}

/** A command to type, with a button that copies it. */
export function command(text: string): HTMLElement {
  const button = part('button', { class: 'button', type: 'button', onclick: () => void copy(text).then((done) => (button.textContent = done ? 'Copied' : 'Copy failed')) }, 'Copy');
  return part('div', { class: 'command' }, part('code', { tabindex: '0' }, text), button);
}
