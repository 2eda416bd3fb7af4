import type { Job } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { inMillimetres } from "../units";
import type { Metrics, Point } from "./meshmend-upload";

function scaled([x = 0, y = 0, z = 0]: readonly number[], factor: number): Point {
  return [x * factor, y * factor, z * factor];
}

/** The numbers to price an order with, measured on the result; null if nothing was measured or no model is available. */
export function metricsOf(job: Job): Metrics | null {
  const report = job.report?.mode === "repair" ? job.report : null;
  const inspection = report && (report.after ?? report.before);
  const print = inspection?.print;
  const { isPrintable, isRefused } = claimsOf(job);
  if (!print || isRefused) return null;
  const unitInMm = inMillimetres(print.unit);
  const times = (value: number | null | undefined, factor: number): number | null => (value == null ? null : value * factor);
  const box = inspection.bounding_box;
  return {
    printable: isPrintable,
    printReady: report?.verdict?.print_ready ?? null,
    unit: print.unit,
    unitSource: print.unit_source,
    sizeMm: scaled(print.size_mm, 1),
    boxMm: box ? { min: scaled(box.min, unitInMm), max: scaled(box.max, unitInMm) } : null,
    volumeMm3: times(print.volume, unitInMm ** 3),
    areaMm2: times(print.area, unitInMm ** 2),
    thinnestWallMm: times(print.thinnest_wall?.thickness, unitInMm),
    solids: print.solids,
  };
}
