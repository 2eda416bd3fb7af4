import type { Job } from "../api/shapes";
import { inMillimetres } from "../units";
import type { Metrics, Point } from "./meshmend-upload";

/** Whether a job's result can be printed as it is. */
export function isPrintable(job: Job): boolean {
  return job.outcome === "already_printable" || job.outcome === "repaired";
}

/** What prices an order, measured on the result; none where nothing was measured. */
export function metricsOf(job: Job): Metrics | null {
  const report = job.report?.mode === "repair" ? job.report : null;
  const inspection = report && (report.after ?? report.before);
  const print = inspection?.print;
  if (!print) return null;
  const own = inMillimetres(print.unit);
  const scaled = (point: Point): Point => [point[0] * own, point[1] * own, point[2] * own];
  const times = (value: number | null | undefined, factor: number): number | null => (value == null ? null : value * factor);
  const box = inspection.bounding_box;
  return {
    printable: isPrintable(job),
    unit: print.unit,
    unitSource: print.unit_source,
    sizeMm: print.size_mm,
    boxMm: box && { min: scaled(box.min), max: scaled(box.max) },
    volumeMm3: times(print.volume, own ** 3),
    areaMm2: times(print.area, own ** 2),
    thinnestWallMm: times(print.thinnest_wall?.thickness, own),
    solids: print.solids,
  };
}
