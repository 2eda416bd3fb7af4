// What the service sends, as far as the page reads it; openapi/openapi.json has all of it.

export type Status = "queued" | "running" | "succeeded" | "failed" | "canceled" | "expired";
export type Outcome =
  | "already_printable"
  | "repaired"
  | "partially_repaired"
  | "unrepairable"
  | "printable"
  | "not_printable"
  | "undecided";
export type Stage = "read" | "inspect" | "repair" | "wait" | "verify" | "finish";
export type Point = [number, number, number];

export interface Progress {
  stage: Stage | null;
  tier: number | null;
  percent: number;
  queue_position: number | null;
}

export interface Artifact {
  href: string;
  filename: string;
  media_type: string;
  bytes: number;
  sha256: string;
}

export interface Input {
  name: string;
  bytes: number;
  sha256: string;
  format: string;
}

export interface JobProblem {
  type: string;
  title: string;
  code: string;
  detail: string;
  place?: unknown;
  file?: number;
}

export type Options = Record<string, unknown>;

export interface Job {
  id: string;
  status: Status;
  outcome: Outcome | null;
  progress: Progress | null;
  attempt: number;
  created_at: string;
  started_at: string | null;
  finished_at: string | null;
  expires_at: string | null;
  input: Input;
  inputs?: Input[];
  options: Options;
  metadata: Record<string, string>;
  reused_from: string | null;
  report: Report | AnalysisReport | null;
  artifacts: Record<string, Artifact>;
  problem: JobProblem | null;
}

/** What an event `progress` says. */
export interface ProgressEvent extends Progress {
  status: Status;
}

export interface JobPage {
  jobs: Job[];
  next: string | null;
}

export interface Deviation {
  complete: boolean;
  distance: { max: number; mean: number; p99: number };
}

export interface SurfaceShare {
  faces: number;
  area: number;
}

export interface ThinPlace {
  at: Point;
  thickness: number;
}

export interface ThinnestWall {
  thickness: number;
  at: Point;
  median: number;
  samples: number;
  /** The thinnest of the samples; earlier versions of the report have none. */
  places?: ThinPlace[];
}

export interface PrintMeasures {
  unit: string;
  unit_source: "declared" | "file" | "assumed";
  size: Point;
  size_mm: Point;
  area: number | null;
  volume: number | null;
  solids: number;
  thinnest_wall?: ThinnestWall | null;
}

export interface Inspection {
  level: string;
  faces: number;
  vertices: number;
  edges: number;
  parts: number;
  boundary_edges: number;
  boundary_loops: number;
  nonmanifold_edges: number;
  nonmanifold_vertices: number;
  misoriented_edges: number;
  degenerate_faces: number;
  duplicate_faces: number;
  inverted_parts: number;
  closed: boolean;
  manifold: boolean;
  consistent: boolean;
  outward: boolean;
  bounding_box: { min: Point; max: Point } | null;
  area: number;
  volume: { value: number; reliable: boolean };
  self_intersections: { checked: boolean; complete: boolean; pairs: number; faces: number };
  defects?: { kind: string; count: number }[];
  check?: { passes: boolean; broken: string[] } | null;
  print?: PrintMeasures | null;
}

export interface Step {
  rung: number;
  tier: number;
  action: string;
  operator?: string | null;
  status: string;
  milliseconds: number;
  changed: { what: string; count: number }[];
  moved?: number;
  note?: string | null;
  program?: { kind: string; version: string } | null;
  voxel_size?: number | null;
}

export interface Ledger {
  parts: number;
  kept: number;
  changed: number;
  united: number;
  duplicate: number;
  no_volume: number;
  inside_another: number;
  debris: number;
  lost: number;
}

export interface Report {
  mode: "repair";
  version: number;
  engine: string;
  outcome: Outcome;
  summary: string;
  options?: Options;
  input: { format: string; dialect: string; bytes: number };
  output: { format: string; dialect: string; bytes: number } | null;
  before: Inspection;
  after: Inspection | null;
  changes: {
    moved?: Deviation | null;
    lost?: Deviation | null;
    made?: Deviation | null;
    surface?: Record<"kept" | "moved" | "added" | "removed", SurfaceShare> | null;
    surface_lost_pct?: number | null;
    volume_change_pct?: number | null;
    box_change_pct?: number | null;
    area_change_pct?: number | null;
  } | null;
  ledger?: Ledger | null;
  plan: { category: string; preset: string; reason: string } | null;
  steps: Step[];
  candidates: { rung: number | null; printable: boolean; defects: number; faces: number; chosen: boolean }[];
  red_flags: { code: string; detail: string }[];
  warnings: string[];
  milliseconds: number;
}

export interface AnalysisReport {
  mode: "analyze";
  version: number;
  engine: string;
  outcome?: Outcome;
  files: { name?: string; inspection?: Inspection | null }[];
}

export interface Capabilities {
  engine: string;
  input_formats: string[];
  output_formats: string[];
  presets: string[];
  tiers: { tier: number; name: string; available: boolean; detail?: string; program?: { kind: string; version: string } }[];
  limits: { max_bytes: number; max_files: number; max_faces: number };
  default_options: Options;
}

export interface Upload {
  id: string;
  put: { method: string; url: string; headers: Record<string, string>; expires_at: string };
  max_bytes: number;
  expires_at: string;
}

export interface Readiness {
  ready: boolean;
  checks: Record<string, string>;
}
