// SPDX-License-Identifier: MIT
import type { Broker, Stream } from '../client/client.js';
import { moved, sum, times, type Vec3 } from '../view/matrix.js';
import type { Pixel } from '../view/camera.js';
import { pick } from '../view/pick.js';
import type { View } from '../view/view.js';
import type { part as makePart } from './parts.js';
import type { Rewinder } from './past.js';
import type { Place } from './place.js';

// A room (protocol.md, section 3): who is here, a camera to follow, pointers and pinned notes on the surface. As
// sdk/room.cpp and client/room_desk.cpp.

const SAY_MS = 100, MAX_SPEED = 10, ASK_AGAIN_MS = 5000, FOLLOW_MS = 150, MAX_NOTE = 500, MAX_NAME = 64, FAR = 1e12, KEPT = 'eigencast name';
// Of a room: the most that rooms.max_room_bytes may be, counted as there; the other limits of protocol.md, section 3.
const MAX_BYTES = 1 << 20, MEMBER_BYTES = 1024, VALUE_BYTES = 128, MAX_VALUE = 2048, MAX_KEYS = 64, MAX_FLOORS = 8, MAX_SECRET = 4096;
const IS_KEY = /^[a-z0-9._-]{1,32}$/;
const COLOURS = ['#e69f00', '#56b4e9', '#009e73', '#f0e442', '#0072b2', '#d55e00', '#cc79a7', '#ff6b8b'];
const STYLE = `
.room { position: absolute; left: 12px; top: 64px; width: 220px; max-height: 60%; overflow: auto; padding: 10px 12px; border-radius: 12px; background: var(--card); font-size: 14px; }
.room ul { margin: 0 0 6px; padding: 0; list-style: none; }
.room li { display: flex; gap: .5em; align-items: baseline; overflow-wrap: anywhere; }
.room li::before { content: ""; flex: none; width: .7em; height: .7em; border-radius: 50%; background: var(--who); }
.room li button { margin-left: auto; border: 0; background: none; cursor: pointer; }
.room .button { width: 100%; margin-bottom: 6px; }
.room input { width: 100%; height: 36px; padding: 0 10px; border: 1px solid var(--line); border-radius: 8px; background: transparent; }
.mark { position: absolute; left: 0; top: 0; pointer-events: none; font-size: 13px; white-space: nowrap; }
.mark::before { content: ""; position: absolute; left: -6px; top: -6px; width: 8px; height: 8px; border: 2px solid #0008; border-radius: 50%; background: var(--who); }
.mark.pointer::before { border-radius: 0 50% 50% 50%; left: 0; top: 0; }
.mark span { position: absolute; left: 10px; top: -10px; max-width: 260px; padding: 1px 7px; border-radius: 7px; background: var(--card); overflow: hidden; text-overflow: ellipsis; }
`;

/** To rooms and back: a broker, which a recording has not. */
export type RoomWay = Pick<Broker, 'onText' | 'sendText'>;
interface Member {
  name: string;
  colour: string;
  here: boolean;
  values: Map<string, unknown>;
}
interface SurfacePoint {
  stream: string;
  corners: [number, number, number];
  weights: Vec3;
  note: string;
}
interface Mark {
  point: SurfacePoint;
  /** Of its first corner in the points that are asked for. */
  first: number;
  element: HTMLElement;
}

type Json = Record<string, unknown>;

function list(value: unknown): unknown[] {
  return Array.isArray(value) ? value : [];
}
function vector(value: unknown): Vec3 | undefined {
  const isOne = Array.isArray(value) && value.length === 3 && value.every((x) => typeof x === 'number' && Math.abs(x) < FAR);
  return isOne ? (value as unknown as Vec3) : undefined;
}
export function pointFrom(value: unknown): SurfacePoint | undefined {
  const { stream, corners, weights, note } = Object(value) as Json, given = vector(weights);
  if (typeof stream !== 'string' || !vector(corners) || !given) return undefined;
  if (!(corners as number[]).every((x) => Number.isInteger(x) && x >= 0 && x < 0xffffffff)) return undefined;
  if (Math.min(...given) < -0.01 || Math.abs(given[0] + given[1] + given[2] - 1) > 0.01) return undefined;
  return { stream, corners: corners as [number, number, number], weights: given, note: typeof note === 'string' ? note.slice(0, MAX_NOTE) : '' };
}

/** What a value counts for; too long a one is never room for. */
function bytesOf(key: string, value: unknown): number {
  const { length } = JSON.stringify(value);
  return length > MAX_VALUE ? Infinity : VALUE_BYTES + 2 * (key.length + length);
}

/** What is known of a room. */
export class RoomState {
  self = 0;
  speaks = false;
  resume = '';
  readonly members = new Map<number, Member>();
  readonly floors = new Map<string, number>();
  #bytes = 0;

  /** What is not of its type, or beyond what a room may hold, is as if it were not there. */
  take(news: Json): void {
    if (typeof news['self'] === 'number') {
      this.self = news['self'];
      this.resume = String(news['resume'] ?? '').slice(0, MAX_SECRET);
      this.speaks = news['speaks'] === true;
    }
    if (news['whole'] === true) {
      this.members.clear();
      this.floors.clear();
      this.#bytes = 0;
    }
    for (const id of list(news['gone'])) this.#remove(Number(id));
    for (const one of list(news['members'])) {
      const { id, name, colour, here, values } = Object(one) as Json;
      if (typeof id !== 'number') continue;
      const member = this.members.get(id) ?? this.#add(id);
      if (!member) continue;
      if (typeof name === 'string') member.name = name.slice(0, MAX_NAME);
      if (/^#[0-9a-f]{6}$/i.test(String(colour))) member.colour = String(colour);
      member.here = here !== false;
      for (const [key, value] of Object.entries(Object(values) as Json)) this.#put(member.values, key, value);
    }
    for (const one of list(news['floors'])) {
      const { floor, member } = Object(one) as Json;
      if (member === 0) this.floors.delete(String(floor));
      else if (this.floors.has(String(floor)) || (this.floors.size < MAX_FLOORS && IS_KEY.test(String(floor)))) this.floors.set(String(floor), Number(member));
    }
  }
  #add(id: number): Member | undefined {
    if (this.#bytes + MEMBER_BYTES > MAX_BYTES) return undefined;
    this.#bytes += MEMBER_BYTES;
    const member = { name: '', colour: '#808080', here: true, values: new Map<string, unknown>() };
    this.members.set(id, member);
    return member;
  }
  #remove(id: number): void {
    const member = this.members.get(id);
    if (!member) return;
    for (const key of member.values.keys()) this.#put(member.values, key, null);
    this.members.delete(id);
    this.#bytes -= MEMBER_BYTES;
  }
  /** Of one that may not be put, the value before is not true either. */
  #put(values: Map<string, unknown>, key: string, value: unknown): void {
    const before = values.has(key) ? bytesOf(key, values.get(key)) : 0, after = value === null ? 0 : bytesOf(key, value);
    const isNew = before === 0, fits = this.#bytes + after - before <= MAX_BYTES && !(isNew && (values.size >= MAX_KEYS || !IS_KEY.test(key)));
    this.#bytes += (fits ? after : 0) - before;
    if (value === null || !fits) values.delete(key);
    else values.set(key, value);
  }
  get leader(): Member | undefined {
    return this.members.get(this.floors.get('lead') ?? 0);
  }
}

/** As the broker takes it: at most 64 bytes, no control characters. */
export function nameFrom(text: string): string {
  let name = text.replace(/[\0-\x1f\x7f]/g, '');
  while (new TextEncoder().encode(name).length > MAX_NAME) name = [...name].slice(0, -1).join('');
  return name;
}
function colourOf(name: string): string {
  let hash = 2166136261;  // FNV-1a, as native programs.
  for (const byte of new TextEncoder().encode(name)) hash = Math.imul(hash ^ byte, 16777619) >>> 0;
  return COLOURS[hash % COLOURS.length]!;
}

/** The page's part in a room. */
export class RoomDesk {
  readonly state = new RoomState();
  follows = true;
  readonly #place: Place;
  readonly #broker: RoomWay;
  readonly #stream: Stream;
  readonly #view: View;
  readonly #part: typeof makePart;
  readonly #main: HTMLElement;
  readonly #name: string;
  readonly #panel: HTMLElement;
  readonly #note: HTMLInputElement;
  readonly #marks = new Map<string, Mark>();
  /** Texts of values, which go out again on a new connection. */
  readonly #said = new Map<string, { value: unknown; keep: boolean; waits: boolean }>();
  #trouble = '';
  #leader = 0;
  #at: Pixel | undefined;
  #pointed = '';
  #isPointing = false;
  #eye = '';
  #turnedMs = 0;
  #enteredMs = 0;
  readonly #past: Rewinder;
  #heardSeek = '';

  constructor(place: Place, broker: RoomWay, stream: Stream, view: View, main: HTMLElement, part: typeof makePart, past: Rewinder) {
    [this.#place, this.#broker, this.#stream, this.#view, this.#main, this.#part, this.#past] = [place, broker, stream, view, main, part, past];
    this.#name = nameFrom(place.person) || nameFrom(kept()) || `guest ${Math.floor(100 + 900 * Math.random())}`;
    keep(this.#name);
    this.#note = part('input', { placeholder: 'a note; T pins it here', maxlength: String(MAX_NOTE), 'aria-label': 'Note' });
    this.#panel = part('section', { class: 'room', 'aria-label': `Room ${place.room}` });
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
    main.append(this.#panel);
    broker.onText.add((text) => this.#onText(text));
    const { canvas } = view, pixel = (event: MouseEvent): Pixel => {
      const { left, top } = canvas.getBoundingClientRect();
      return [event.clientX - left, event.clientY - top];
    };
    // Whoever leads next is not followed either: some would take the lead again and again.
    const stop = (): void => void (this.follows &&= [0, this.state.self].includes(this.#leader));
    canvas.addEventListener('pointermove', (event) => {
      this.#at = pixel(event);
      if (event.buttons !== 0) stop();
    });
    canvas.addEventListener('pointerleave', () => (this.#at = undefined));
    canvas.addEventListener('wheel', stop, { passive: true });
    document.addEventListener('keydown', ({ key, target, ctrlKey, metaKey, altKey }) => {
      if (ctrlKey || metaKey || altKey || (target as Element).matches('input, textarea')) return;
      const does = { t: () => this.#pin(), o: () => this.lead(), j: () => (this.follows = !this.follows) }[key.toLowerCase()];
      if (!does) return;
      does();
      this.#refresh();
    });
    setInterval(() => (this.#followInTime(), this.#say()), SAY_MS);
    const turn = (nowMs: number): void => {
      requestAnimationFrame(turn);
      this.#turn(nowMs);
    };
    requestAnimationFrame(turn);
    this.#enter();
  }

  lead(): void {
    const { state } = this;
    this.#eye = '';
    this.#send('floor', { floor: 'lead', take: state.leader === undefined || this.#leader !== state.self });
  }

  #send(op: string, fields: object): void {
    this.#broker.sendText(JSON.stringify({ op, room: this.#place.room, ...fields }));
  }
  #enter(): void {
    this.#enteredMs = Date.now();
    this.state.self = 0;
    const { resume } = this.state;
    this.#send('enter', { name: this.#name, colour: colourOf(this.#name), ...(resume === '' ? {} : { resume }) });
    for (const said of this.#said.values()) said.waits = true;
  }
  #onText(text: string): void {
    if (text === '') return this.#enter();  // The connection is new.
    try {
      const json = JSON.parse(text) as Json;
      if (json['room'] !== this.#place.room) return;
      if (json['op'] === 'error') this.#trouble = String(json['message']);
      if (json['op'] !== 'room') return this.#refresh();
      this.#trouble = '';
      this.state.take(json);
    } catch (error) {
      console.warn(`eigencast: room: ${(error as Error).message}`);
    }
    this.#leader = this.state.floors.get('lead') ?? 0;
    this.#placeMarks();
    this.#refresh();
  }
  #followInTime(): void {
    const { leader, self } = this.state, value = leader?.values.get('seek'), text = JSON.stringify(value) ?? '';
    if (!leader || this.#leader === self) this.#heardSeek = '';
    if (!leader || this.#leader === self || !this.follows || !this.#past.hasPast || text === this.#heardSeek) return;
    this.#heardSeek = text;
    const { at_us, speed } = Object(value) as Json;
    const isGood = Number.isSafeInteger(at_us) && Number(at_us) >= 0 && typeof speed === 'number' && (speed === 0 || (speed >= 1 / MAX_SPEED && speed <= MAX_SPEED));
    this.#past.follow(isGood ? { atUs: Number(at_us), speed } : undefined);
  }
  #tell(key: string, value: unknown, keep = false): void {
    const text = JSON.stringify(value), said = this.#said.get(key);
    if (said ? JSON.stringify(said.value) !== text : value !== null) this.#said.set(key, { value, keep, waits: true });
  }
  #say(): void {
    const { state } = this;
    if (state.self === 0) {
      if (Date.now() - this.#enteredMs > ASK_AGAIN_MS) this.#enter();
      return;
    }
    if (!state.speaks) return;
    const { camera } = this.#view, isLeading = this.#leader === state.self;
    const { led } = this.#past;
    this.#tell('camera', isLeading ? { eye: camera.position, target: camera.target } : null);
    this.#tell('seek', isLeading && led ? { stream: this.#place.stream, at_us: led.atUs, speed: led.speed } : null);
    this.#point();
    for (const keep of [false, true]) {
      const values: Record<string, unknown> = {};
      for (const [key, said] of this.#said) {
        if (!said.waits || said.keep !== keep) continue;
        values[key] = said.value;
        said.waits = false;
        if (said.value === null) this.#said.delete(key);
      }
      if (Object.keys(values).length > 0) this.#send('say', { values, ...(keep ? { keep } : {}) });
    }
  }

  /** Of the surface under the cursor. */
  async #under(at: Pixel | undefined): Promise<Omit<SurfacePoint, 'note'> | undefined> {
    const hit = at && pick(this.#view.pickable, this.#view.camera, at), rebuilt = this.#view.live.drawn?.rebuilt;
    if (!hit || !rebuilt) return undefined;
    const corners = [...(await this.#stream.sources(Uint32Array.from(hit.vertices), rebuilt.vertices !== rebuilt.level))] as [number, number, number];
    return corners.includes(0xffffffff) ? undefined : { stream: this.#place.stream, corners, weights: hit.weights };
  }
  #point(): void {
    const at = String(this.#at);
    if (at === this.#pointed || this.#isPointing) return;
    this.#pointed = at;
    this.#isPointing = true;
    void this.#under(this.#at).then((point) => this.#tell('pointer', point ?? null), () => {}).finally(() => (this.#isPointing = false));
  }
  #pin(): void {
    void this.#under(this.#at).then((point) => {
      if (!point || !this.state.speaks) return;
      let number = 1;
      const mine = this.state.members.get(this.state.self)?.values;
      while (mine?.has(`pin.${number}`) || this.#said.has(`pin.${number}`)) ++number;
      this.#tell(`pin.${number}`, { ...point, note: this.#note.value }, true);
      this.#note.value = '';
    }, () => {});
  }

  /** Which elements there are, and which vertices they need. */
  #placeMarks(): void {
    const points: number[] = [], wanted = new Set<string>(), { state } = this;
    for (const [id, { name, colour, values }] of state.members) {
      for (const [key, value] of values) {
        const isPin = key.startsWith('pin.'), point = isPin || (key === 'pointer' && id !== state.self) ? pointFrom(value) : undefined;
        if (point?.stream !== this.#place.stream) continue;
        const mark = `${id} ${key}`, text = isPin ? point.note : name;
        wanted.add(mark);
        let known = this.#marks.get(mark);
        if (!known) {
          known = { point, first: 0, element: this.#part('div', { class: isPin ? 'mark' : 'mark pointer', hidden: true }, this.#part('span', {})) };
          this.#marks.set(mark, known);
          this.#main.append(known.element);
        }
        known.point = point;
        known.first = points.length;
        known.element.style.setProperty('--who', colour);
        const span = known.element.firstElementChild as HTMLElement;
        span.textContent = text;
        span.hidden = text === '';
        points.push(...point.corners);
      }
    }
    for (const [mark, { element }] of this.#marks) {
      if (wanted.has(mark)) continue;
      element.remove();
      this.#marks.delete(mark);
    }
    this.#view.live.points = points.length > 0 ? Uint32Array.from(points) : undefined;
  }
  #turn(nowMs: number): void {
    const { camera, canvas, live } = this.#view, passedMs = Math.min(nowMs - this.#turnedMs, FOLLOW_MS);
    this.#turnedMs = nowMs;
    const led = this.follows && this.#leader !== this.state.self ? (Object(this.state.leader?.values.get('camera')) as Json) : {};
    const eye = vector(led['eye']), target = vector(led['target']);
    if (eye && target && String([eye, target]) !== this.#eye) {
      const rest = Math.exp((-3 * passedMs) / FOLLOW_MS), towards = (from: Vec3, to: Vec3): Vec3 => sum(times(rest, from), times(1 - rest, to));
      const near = [...camera.position, ...camera.target].every((x, i) => Math.abs(x - [...eye, ...target][i]!) < 1e-4 * camera.radius);
      const [from, at] = near ? [eye, target] : [towards(camera.position, eye), towards(camera.target, target)];
      if (near) this.#eye = String([eye, target]);
      if (Math.hypot(...sum(from, times(-1, at))) > 1e-6) camera.lookFrom(from, at);
      this.#view.invalidate();
    }
    const placed = live.drawn?.rebuilt.points, asked = live.points?.length ?? 0;
    for (const { point: { weights }, first, element } of this.#marks.values()) {
      if (placed?.length !== 3 * asked) break;  // Those that are asked for are on their way.
      const corner = (i: number): Vec3 => times(weights[i]!, [...placed.subarray(3 * (first + i), 3 * (first + i) + 3)] as unknown as Vec3);
      const [x, y, z] = moved(camera.viewFromScene, moved(live.sceneFromSurface, sum(corner(0), sum(corner(1), corner(2)))));
      const f = camera.clipFromView[5]! * canvas.clientHeight / 2;
      element.hidden = !(z < 0);
      if (z < 0) element.style.transform = `translate(${canvas.clientWidth / 2 - (f * x) / z}px, ${canvas.clientHeight / 2 + (f * y) / z}px)`;
    }
  }

  #refresh(): void {
    const { state } = this, part = this.#part, isLeading = this.#leader === state.self && state.self !== 0;
    const people = part('ul', {}), pins = part('ul', {});
    const row = (colour: string, ...inside: (Node | string)[]): HTMLElement => {
      const made = part('li', {}, ...inside);
      made.style.setProperty('--who', colour);
      return made;
    };
    for (const [id, member] of state.members) {
      const leads = id === this.#leader ? ' (leads)' : '', you = id === state.self ? ' (you)' : '';
      if (member.here) people.append(row(member.colour, member.name + you + leads));
      for (const [key, value] of member.values) {
        const point = key.startsWith('pin.') ? pointFrom(value) : undefined;
        if (point?.stream !== this.#place.stream) continue;
        const remove = (): void => (id === state.self ? this.#tell(key, null, true) : this.#send('say', { values: { [key]: null }, member: id }));
        const button = state.speaks && (id === state.self || !member.here) ? [part('button', { type: 'button', 'aria-label': 'Remove', onclick: remove }, '\u00d7')] : [];
        pins.append(row(member.colour, point.note || '(no note)', ...button));
      }
    }
    const button = (text: string, onclick: () => void): HTMLElement => part('button', { class: 'button', type: 'button', onclick: () => (onclick(), this.#refresh()) }, text);
    const lead = isLeading ? 'Stop leading (O)' : state.leader ? 'Take the lead (O)' : 'Lead (O)';
    const isTyping = document.activeElement === this.#note;
    this.#panel.replaceChildren(
      ...(this.#trouble === '' ? [] : [this.#trouble]), people,
      ...(state.leader && !isLeading ? [button(this.follows ? 'Stop following (J)' : 'Follow (J)', () => (this.follows = !this.follows))] : []),
      ...(state.speaks ? [button(lead, () => this.lead()), this.#note] : []), pins);
    if (isTyping) this.#note.focus();
  }
}

function kept(): string {
  try {
    return localStorage.getItem(KEPT) ?? '';
  } catch {
    return '';
  }
}
function keep(name: string): void {
  try {
    localStorage.setItem(KEPT, name);
  } catch {
    // Pages in sandboxes remember nothing.
  }
}
