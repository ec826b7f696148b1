// SPDX-License-Identifier: MIT

/** Calls listeners by name. What one throws reaches the console, not the others. */
export class Events<Map extends object> {
  readonly #listeners = new Map<keyof Map, Set<(news: never) => void>>();

  /** Returns what takes the listener away. */
  on<Name extends keyof Map>(name: Name, listener: (news: Map[Name]) => void): () => void {
    const set = this.#listeners.get(name) ?? new Set();
    this.#listeners.set(name, set.add(listener));
    return () => void set.delete(listener);
  }
  /** The next news of that name. */
  once<Name extends keyof Map>(name: Name): Promise<Map[Name]> {
    return new Promise((resolve) => {
      const stop = this.on(name, (news) => {
        stop();
        resolve(news);
      });
    });
  }
  protected emit<Name extends keyof Map>(name: Name, news: Map[Name]): void {
    for (const listener of [...(this.#listeners.get(name) ?? [])]) {
      try {
        (listener as (news: Map[Name]) => void)(news);
      } catch (error) {
        console.error(error);
      }
    }
  }
}
