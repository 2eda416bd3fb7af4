import type { Job } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { inMillimetres } from "../units";
import type { Metrics, Point } from "./meshmend-upload";

function scaled([x = 0, y = 0, z = 0]: readonly number[], factor: number): Point {
  return [x * factor, y * factor, z * factor];
}

/** What prices an order, measured on the result; none where nothing was measured, or nothing is handed out. */
export function metricsOf(job: Job): Metrics | null {
  const report = job.report?.mode === "repair" ? job.report : null;
  const inspection = report && (report.after ?? report.before);
  const print = inspection?.print;
  const { isPrintable, isRefused } = claimsOf(job);
  if (!print || isRefused) return null;
  const own = inMillimetres(print.unit);
  const times = (value: number | null | undefined, factor: number): number | null => (value == null ? null : value * factor);
  const box = inspection.bounding_box;
  return {
    printable: isPrintable,
    unit: print.unit,
    unitSource: print.unit_source,
    sizeMm: scaled(print.size_mm, 1),
    boxMm: box ? { min: scaled(box.min, own), max: scaled(box.max, own) } : null,
    volumeMm3: times(print.volume, own ** 3),
    areaMm2: times(print.area, own ** 2),
    thinnestWallMm: times(print.thinnest_wall?.thickness, own),
    solids: print.solids,
  };
}
