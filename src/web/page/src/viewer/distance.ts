/** A point in the model's unit. */
export type Point = [number, number, number];

/** The length between two points, and its share along each axis. */
export function distance(a: Point, b: Point): { length: number; along: Point } {
  const along = a.map((x, k) => Math.abs(b[k]! - x)) as Point;
  return { length: Math.hypot(...along), along };
}
