/** Which of the two sides are visible, and how. */
export type Mode = "both" | "wipe" | "before" | "after";
export type SideName = "before" | "after";

/** The viewport and the scissor box of one side, in CSS pixels from the lower left as in WebGL. */
export interface Pane {
  side: SideName;
  view: [number, number, number, number];
  scissor: [number, number, number, number];
}

/** Below this width in pixels, the sides are stacked vertically. */
const NARROW = 560;

export function panes(mode: Mode, width: number, height: number, wipe: number, has: (side: SideName) => boolean): Pane[] {
  const whole: [number, number, number, number] = [0, 0, width, height];
  const only = (side: SideName): Pane[] => [{ side, view: whole, scissor: whole }];
  if (!has("after")) return only("before");
  if (!has("before")) return only("after");
  if (mode === "before" || mode === "after") return only(mode);
  if (mode === "wipe") {
    const x = Math.round(width * wipe);
    return [
      { side: "before", view: whole, scissor: [0, 0, x, height] },
      { side: "after", view: whole, scissor: [x, 0, width - x, height] },
    ];
  }
  if (width < NARROW) {
    const half = Math.floor(height / 2);
    const [upper, lower]: [Pane["view"], Pane["view"]] = [[0, height - half, width, half], [0, 0, width, height - half]];
    return [{ side: "before", view: upper, scissor: upper }, { side: "after", view: lower, scissor: lower }];
  }
  const half = Math.floor(width / 2);
  const [left, right]: [Pane["view"], Pane["view"]] = [[0, 0, half, height], [half, 0, width - half, height]];
  return [{ side: "before", view: left, scissor: left }, { side: "after", view: right, scissor: right }];
}
