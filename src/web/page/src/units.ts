/** The units that users choose from; below, the units of models in millimetres. */
export const UNITS = ["mm", "cm", "in"] as const;
export type Unit = (typeof UNITS)[number];
const MILLIMETRES: Record<string, number> = { um: 0.001, mm: 1, cm: 10, m: 1000, in: 25.4, ft: 304.8 };

export function inMillimetres(unit: string): number {
  return MILLIMETRES[unit] ?? 1;
}

/** Formats numbers for a language. */
export class Figures {
  constructor(readonly language: string) {}

  /** A whole number. */
  count(value: number): string {
    return new Intl.NumberFormat(this.language, { maximumFractionDigits: 0 }).format(value);
  }

  /** A number with the given significant digits, without trailing zeros. */
  number(value: number, digits = 4): string {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e9 || size < 1e-6)) {
      return new Intl.NumberFormat(this.language, { notation: "scientific", maximumSignificantDigits: 3 }).format(value);
    }
    return new Intl.NumberFormat(this.language, { maximumSignificantDigits: Math.max(digits, size >= 1 ? Math.floor(Math.log10(size)) + 1 : 1) }).format(value);
  }

  percent(value: number): string {
    return new Intl.NumberFormat(this.language, { style: "percent", maximumFractionDigits: value < 0.1 ? 2 : 1 }).format(value);
  }

  /** A length in millimetres, in a unit. */
  length(millimetres: number, unit: Unit, digits = 4): string {
    return `${this.number(millimetres / inMillimetres(unit), digits)} ${unit}`;
  }

  /** The three sides of a box. */
  box(millimetres: readonly number[], unit: Unit): string {
    return `${millimetres.map((side) => this.number(side / inMillimetres(unit))).join(" × ")} ${unit}`;
  }

  area(squareMillimetres: number, unit: Unit): string {
    return `${this.number(squareMillimetres / inMillimetres(unit) ** 2)} ${unit}²`;
  }

  /** A volume. With lengths in mm it is in cm³, which printers and shops use. */
  volume(cubicMillimetres: number, unit: Unit): string {
    const told = unit === "mm" ? "cm" : unit;
    return `${this.number(cubicMillimetres / inMillimetres(told) ** 3)} ${told}³`;
  }

  bytes(value: number): string {
    const names = ["B", "kB", "MB", "GB"];
    let power = 0;
    for (; value >= 1000 && power < names.length - 1; power += 1) value /= 1000;
    return `${new Intl.NumberFormat(this.language, { maximumSignificantDigits: 3 }).format(value)} ${names[power]}`;
  }

  seconds(milliseconds: number): string {
    const [value, unit] = milliseconds < 1000 ? [Math.max(milliseconds, 0), "ms"] : [milliseconds / 1000, "s"];
    if (milliseconds >= 90_000) return `${this.number(Math.round(milliseconds / 6000) / 10, 3)} min`;
    return `${this.number(value, value < 10 ? 2 : 3)} ${unit}`;
  }

  time(iso: string): string {
    return new Intl.DateTimeFormat(this.language, { dateStyle: "medium", timeStyle: "short" }).format(new Date(iso));
  }
}

/** Whether a box of this size fits into a build volume: as it is, turned, or not at all. */
export function fit(size: readonly number[], buildVolume: readonly number[]): "as_is" | "turned" | "no" {
  const within = (a: readonly number[], b: readonly number[]): boolean => a.every((side, k) => side <= b[k]!);
  if (within(size, buildVolume)) return "as_is";
  const sorted = (it: readonly number[]): number[] => [...it].sort((a, b) => a - b);
  return within(sorted(size), sorted(buildVolume)) ? "turned" : "no";
}
