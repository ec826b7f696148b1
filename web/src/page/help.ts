// SPDX-License-Identifier: MIT
import type { Command, Desk } from './commands.js';
import type { part as Part } from './parts.js';

/** What keys and the pointer do, and where switches are. */
export function helpOf(desk: Desk, commands: readonly Command[], part: typeof Part): Node[] {
  const line = (keys: string, does: string): Node[] => [part('dt', {}, keys), part('dd', {}, does)];
  return [
    part('h2', {}, 'Keys'),
    part('dl', {}, ...line('drag, arrows', 'rotate'), ...line('right or two-finger drag, Shift + arrows', 'pan'), ...line('wheel, pinch, Page Up, Page Down', 'zoom'),
      ...line('double click', 'turn round the point that was hit'),
      ...commands.flatMap((command) => {
        const state = command.state?.(desk) ?? (command.isOn && (command.isOn(desk) ? 'on' : 'off'));
        return line(command.keys.map((key) => (key === ' ' ? 'Space' : key)).join(' '), command.does + (state ? `: ${state}` : ''));
      })),
  ];
}
