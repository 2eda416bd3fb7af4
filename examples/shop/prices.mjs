// Prices of models. The backend gets the measures from meshmend, because a browser can forge them.

/** The limits of this shop's printer, in millimetres. */
const ROOM = [250, 210, 210];
const THINNEST = 0.4;
const CENTS = { perOrder: 390, perCm3: 38, perCm2: 2 };

/** The id of a job's own result. Others are alternatives, if the job has the option `alternatives`. */
export const DEFAULT = "default";

/** The model of one of a job's results. */
export function modelOf({ artifacts }, choice) {
  return choice === DEFAULT ? artifacts.model : artifacts[`model-${choice}`];
}

/** The measures and assumptions of one of a job's results; null if there is no such result. */
function resultOf({ quote, report, alternatives }, choice) {
  if (choice === DEFAULT) return { ...quote, assumptions: report.assumptions.map(({ detail }) => detail) };
  const offered = alternatives?.offered.find(({ id }) => id === choice);
  return offered ? { ...offered, assumptions: [offered.detail] } : null;
}

/** Returns the price of a finished job's result in cents, or the reason why this shop can't print it. */
export function priceOf(job, choice) {
  const quote = job.status === "succeeded" && modelOf(job, choice) ? resultOf(job, choice) : null;
  if (!quote?.printable) return { refusal: "This model can't be printed as it is." };
  if (quote.volume_mm3 === null) return { refusal: "The volume of this model can't be told." };
  const size = [...quote.size_mm].sort((a, b) => b - a);
  if (size.some((side, k) => side > ROOM[k])) return { refusal: `This model is larger than our printer: ${ROOM.join(" × ")} mm.` };
  const wall = quote.thinnest_wall_mm;
  if (wall !== null && wall < THINNEST) return { refusal: `A wall of ${wall.toFixed(2)} mm is too thin; ${THINNEST} mm is the least.` };
  const volumeCm3 = quote.volume_mm3 / 1000;
  const areaCm2 = quote.area_mm2 / 100;
  const cents = Math.ceil(CENTS.perOrder + CENTS.perCm3 * volumeCm3 + CENTS.perCm2 * areaCm2);
  return { cents, volumeCm3, sizeMm: quote.size_mm, assumptions: quote.assumptions };
}
