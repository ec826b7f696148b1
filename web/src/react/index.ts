// SPDX-License-Identifier: MIT
/** `eigencast/react`: <EigencastView src="https://host/lab/horse" />, the element as a component. Renders on servers, too. */
import { createElement, useEffect, useRef, type CSSProperties, type ReactElement } from 'react';
import type { Status } from '../client/subscription.js';
import type { EigencastError } from '../core/module.js';
import type { EigencastView as Element } from '../element/index.js';

export interface EigencastViewProps {
  src: string;
  token?: string;
  /** As the element's attribute. */
  colour?: string;
  still?: boolean;
  preview?: boolean;
  className?: string;
  style?: CSSProperties;
  onStatus?(status: Status): void;
  onError?(error: EigencastError): void;
  /** Each time it shows another stream: camera, style and picture() are in its `view`. */
  onElement?(element: Element): void;
}

export function EigencastView({ src, token = '', colour, still = false, preview = false, className, style, ...handlers }: EigencastViewProps): ReactElement {
  const place = useRef<Element>(null), hear = useRef(handlers);
  hear.current = handlers;
  useEffect(() => {
    const element = place.current!;
    let isGone = false;
    const onStatus = (event: Event): void => hear.current.onStatus?.((event as CustomEvent<Status>).detail);
    const onError = (event: Event): void => hear.current.onError?.((event as CustomEvent<EigencastError>).detail);
    element.addEventListener('status', onStatus);
    element.addEventListener('error', onError);
    // Not before the page runs: servers have no elements.
    void import('../element/index.js').then(() => {
      if (isGone) return;
      element.token = token;
      element.setAttribute('src', src);
      hear.current.onElement?.(element);
    });
    return () => {
      isGone = true;
      element.removeAttribute('src');
      element.removeEventListener('status', onStatus);
      element.removeEventListener('error', onError);
    };
  }, [src, token]);
  return createElement('eigencast-view', { ref: place, colour, still: still ? '' : undefined, preview: preview ? '' : undefined, class: className, style });
}
