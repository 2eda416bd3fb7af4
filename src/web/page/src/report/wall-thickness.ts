import type { Job } from "meshmend-client";
import { optionsOf } from "./advice";
import { readinessOf } from "./print-ready";

/** Limits between the bands of wall thickness in the service's drawings, as multiples of the least wall. */
const BANDS = [0.25, 0.5, 0.75, 1, 1.5, 2, 4];
/** The band of walls that are no concern, and of surface that is part of no wall. */
export const THICK_BAND = `thickness_${BANDS.length}`;

/** The least wall in millimetres to which a drawing of wall thickness relates; null if no option states one. */
export function leastWallOf(job: Job): number | null {
  const asked = optionsOf(job)["min_wall"];
  if (typeof asked === "number") return asked;
  return readinessOf(job)?.rules.find(({ rule }) => rule === "free_wall")?.limit ?? null;
}

/** The walls of a band in millimetres: from and to; null at an open end. */
export function bandOf(kind: string, leastWall: number): { from: number | null; to: number | null } | null {
  const number = Number(/^thickness_(\d)$/.exec(kind)?.[1] ?? Number.NaN);
  if (!(number <= BANDS.length)) return null;
  const limit = (k: number): number | null => (BANDS[k] === undefined ? null : BANDS[k] * leastWall);
  return { from: limit(number - 1), to: limit(number) };
}
