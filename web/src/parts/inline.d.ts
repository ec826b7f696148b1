// SPDX-License-Identifier: MIT

/** Files that were built, as the build puts them inside: a module's bytes, deflated, in base64, a script's text. */
declare module 'inline:*' {
  const contents: string;
  export default contents;
}
