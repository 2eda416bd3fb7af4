// What a model costs. The numbers are meshmend's, asked for by the backend: what a browser says of a model can be made up.

const MILLIMETRES = { um: 0.001, mm: 1, cm: 10, m: 1000, in: 25.4, ft: 304.8 };
/** What this shop's printer can make, in millimetres. */
const ROOM = [250, 210, 210];
const THINNEST = 0.4;
const CENTS = { perOrder: 390, perCm3: 38, perCm2: 2 };

/** The price of a finished job's result in cents, or why this shop can't print it. */
export function priceOf({ status, report, artifacts }) {
  if (status !== "succeeded" || !report.verdict.printable || !artifacts.model) return { refusal: "This model can't be printed as it is." };
  const { print } = report.after;
  if (print.volume === null) return { refusal: "The volume of this model can't be told." };
  const unit = MILLIMETRES[print.unit];
  const size = [...print.size_mm].sort((a, b) => b - a);
  if (size.some((side, k) => side > ROOM[k])) return { refusal: `This model is larger than our printer: ${ROOM.join(" × ")} mm.` };
  const wall = print.thinnest_wall && print.thinnest_wall.thickness * unit;
  if (wall && wall < THINNEST) return { refusal: `A wall of ${wall.toFixed(2)} mm is too thin; ${THINNEST} mm is the least.` };
  const volumeCm3 = (print.volume * unit ** 3) / 1000;
  const areaCm2 = (print.area * unit ** 2) / 100;
  const cents = Math.ceil(CENTS.perOrder + CENTS.perCm3 * volumeCm3 + CENTS.perCm2 * areaCm2);
  return { cents, volumeCm3, sizeMm: print.size_mm, assumptions: report.assumptions.map(({ detail }) => detail) };
}
