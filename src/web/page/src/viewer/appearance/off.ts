import { type Appearance, PatchBuilder } from "./appearance";

/** Reads the colours of an OFF file, at its vertices (`COFF`) or its faces. */
export function readOff(bytes: Uint8Array): Appearance {
  const lines = new TextDecoder()
    .decode(bytes)
    .split("\n")
    .map((line) => line.replace(/#.*/, "").trim())
    .filter((line) => line !== "");
  const [, kind = "", rest = ""] = /^([A-Z4]*OFF)\s*(.*)$/.exec(lines[0] ?? "") ?? [];
  let next = rest === "" ? 1 : 0;
  const counts = (rest === "" ? lines[next]! : rest).split(/\s+/).map(Number);
  const [hasColours, hasNormals] = [kind.includes("C"), kind.includes("N")];
  const points: number[][] = [];
  const tints: (number[] | null)[] = [];
  for (let i = 0; i < counts[0]!; i += 1) {
    const words = lines[(next += 1)]!.split(/\s+/);
    points.push(words.slice(0, 3).map(Number));
    tints.push(hasColours ? colourOf(words.slice(hasNormals ? 6 : 3)) : null);
  }
  const [tinted, plain] = [new PatchBuilder(), new PatchBuilder()];
  for (let i = 0; i < counts[1]!; i += 1) {
    const words = lines[(next += 1)]!.split(/\s+/);
    const corners = words.slice(1, 1 + Number(words[0])).map(Number);
    const own = colourOf(words.slice(1 + corners.length));
    for (let k = 2; k < corners.length; k += 1) {
      for (const v of [corners[0]!, corners[k - 1]!, corners[k]!]) {
        const [point, tint] = [points[v], own ?? tints[v]];
        if (point) (tint ? tinted : plain).add(point, tint ?? null);
      }
    }
  }
  return { patches: [tinted, plain].map((builder) => builder.build()).filter((patch) => patch !== null), up: null };
}

/** Parses a colour: integers up to 255, or fractions up to 1. A single number is an index into another file, which is not supported. */
function colourOf(words: string[]): number[] | null {
  if (words.length < 3) return null;
  const numbers = words.slice(0, 3).map(Number);
  const isWhole = words.slice(0, 3).every((word) => !word.includes("."));
  return isWhole && numbers.some((x) => x > 1) ? numbers.map((x) => x / 255) : numbers;
}
