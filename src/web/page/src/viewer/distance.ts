/** A point in the model's unit. */
export type Point = [number, number, number];

/** A smaller share of a length is a rounding error. */
const NOTHING = 1e-5;

/** The distance between two points, and its component along each axis. */
export function distance(a: Point, b: Point): { length: number; along: Point } {
  const along = a.map((x, k) => Math.abs(b[k]! - x));
  const length = Math.hypot(...along);
  return { length, along: along.map((part) => (part < NOTHING * length ? 0 : part)) as Point };
}
