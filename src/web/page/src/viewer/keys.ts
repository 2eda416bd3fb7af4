import type { Viewer } from "./viewer";

/** The angle of one key press in radians, and the zoom factor. */
const STEP = 0.12;
const NEARER = 0.85;

const KEYS: Record<string, (viewer: Viewer) => void> = {
  ArrowLeft: (viewer) => viewer.turn(-STEP, 0),
  ArrowRight: (viewer) => viewer.turn(STEP, 0),
  ArrowUp: (viewer) => viewer.turn(0, STEP),
  ArrowDown: (viewer) => viewer.turn(0, -STEP),
  "+": (viewer) => viewer.turn(0, 0, NEARER),
  "-": (viewer) => viewer.turn(0, 0, 1 / NEARER),
  "0": (viewer) => viewer.home(),
};

/** Handles a key press on the canvas. */
export function pressed(viewer: Viewer | undefined, event: KeyboardEvent): void {
  const act = KEYS[event.key];
  if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  if (viewer) act(viewer);
}
