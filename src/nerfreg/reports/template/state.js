"use strict";
// What is seen stands in the fragment of the address, so that it can be shared: #sort=psnr&order=down&view=...&split=30
document.documentElement.classList.add("script");

const state = {
  values: new URLSearchParams(),
  readers: [],

  get(name) { return this.values.get(name); },

  set(changes) {
    for (const [name, value] of Object.entries(changes)) this.values.set(name, value);
    history.replaceState(null, "", "#" + this.values);
  },

  // A fragment without "=" is a link to a section, and changes nothing.
  read() {
    const fragment = location.hash.slice(1);
    if (!fragment.includes("=")) return;
    this.values = new URLSearchParams(fragment);
    for (const reader of this.readers) reader();
  },

  onRead(reader) {
    this.readers.push(reader);
    reader();
  },
};
if (location.hash.includes("=")) state.values = new URLSearchParams(location.hash.slice(1));
addEventListener("hashchange", () => state.read());
