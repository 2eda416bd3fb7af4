/** The script of this element: the one that runs, or of a module, of which that is not told, the one that is named so. */
const script = document.currentScript ?? document.querySelector("script[src*='/widget.js']");

/** The service that the script came from; that of the page, where it came in another way. */
export const ORIGIN = new URL(script instanceof HTMLScriptElement && script.src ? script.src : location.href).origin;
