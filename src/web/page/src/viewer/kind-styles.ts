/** Patterns and marks distinguish kinds without colour. */
export type Pattern = "plain" | "stripes" | "dots" | "crossed" | "bars" | "checks";
export const PATTERNS: Pattern[] = ["plain", "stripes", "dots", "crossed", "bars", "checks"];
export type Mark = "circle" | "square" | "diamond" | "triangle";
export const MARKS: Mark[] = ["circle", "square", "diamond", "triangle"];

/** The pattern and the mark of a family of kinds. */
export interface KindStyle {
  family: Family;
  pattern: Pattern;
  mark: Mark;
  dashed: boolean;
}

export type Family = "open" | "non_manifold" | "crossing" | "flipped" | "needless" | "parts" | "thin" | "change";

const FAMILIES: Record<Family, Omit<KindStyle, "family">> = {
  open: { pattern: "dots", mark: "circle", dashed: false },
  non_manifold: { pattern: "checks", mark: "diamond", dashed: true },
  crossing: { pattern: "crossed", mark: "triangle", dashed: false },
  flipped: { pattern: "bars", mark: "triangle", dashed: true },
  needless: { pattern: "checks", mark: "square", dashed: false },
  parts: { pattern: "plain", mark: "square", dashed: false },
  thin: { pattern: "plain", mark: "diamond", dashed: false },
  change: { pattern: "stripes", mark: "circle", dashed: false },
};

const KINDS: Record<string, Family> = {
  hole: "open",
  slit: "open",
  crack: "open",
  t_junction: "open",
  non_manifold_edge: "non_manifold",
  non_manifold_vertex: "non_manifold",
  self_intersection: "crossing",
  misoriented_edge: "flipped",
  inverted_part: "flipped",
  bad_vertex_normal: "flipped",
  corrupt: "needless",
  duplicate_face: "needless",
  opposite_face: "needless",
  degenerate_face: "needless",
  flat_face: "needless",
  foldover: "needless",
  sheet: "needless",
  disjoint: "parts",
  inner_shell: "parts",
  tiny_part: "parts",
  thin_wall: "thin",
  added: "change",
  removed: "change",
  moved: "change",
};

export function styleOf(kind: string): KindStyle {
  const family = KINDS[kind] ?? (kind.startsWith("thickness_") ? "thin" : "needless");
  return { family, ...FAMILIES[family] };
}

/** Remarks are hidden at first, because they would cover the defects. */
export function isShownAtFirst(kind: string): boolean {
  return !["disjoint", "inner_shell", "removed"].includes(kind);
}
