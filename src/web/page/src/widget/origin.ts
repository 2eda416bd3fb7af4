/** The script of this element. A module has no `currentScript`; then the script is found by its name. */
const script = document.currentScript ?? document.querySelector("script[src*='/widget.js']");

/** Origin of the service that the script came from; the page's origin if the script has no address. */
export const ORIGIN = new URL(script instanceof HTMLScriptElement && script.src ? script.src : location.href).origin;
