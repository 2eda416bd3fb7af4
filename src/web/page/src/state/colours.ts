import { type Job, type Server, fetchArtifact } from "meshmend-client";
import { weightOf } from "../report/files";
import { claimsOf } from "../report/verdict";
import type { SideName } from "../viewer/layout";

/** Formats that can store colours. */
const COLOURED = ["glb", "obj", "zip", "ply", "off", "3mf"];
/** Larger files are shown without their original colours. */
const MOST_BYTES = 80_000_000;

/** A file that may have the colours of one side. */
export interface ColouredFile {
  side: SideName;
  bytes: () => Promise<ArrayBuffer>;
}

/** The files that may have the colours of a job's models: the uploaded file, if available, and the result. */
export function colouredFiles(server: Server, job: Job, file: File | null, signal: AbortSignal): ColouredFile[] {
  const report = job.report?.mode === "repair" ? job.report : null;
  const { model, original } = claimsOf(job);
  const files: ColouredFile[] = [];
  const fetched = (name: "model" | "original") => async (): Promise<ArrayBuffer> => fetchArtifact(server, job.artifacts[name]!, signal);
  if (COLOURED.includes(job.input.format)) {
    const isSame = job.outcome === "already_printable" && report?.output?.format === job.input.format;
    if (file && file.size <= MOST_BYTES) files.push({ side: "before", bytes: () => file.arrayBuffer() });
    else if (original && weightOf(job, "original") <= MOST_BYTES) files.push({ side: "before", bytes: fetched("original") });
    else if (model && isSame && weightOf(job, "model") <= MOST_BYTES) files.push({ side: "before", bytes: fetched("model") });
  }
  if (model && COLOURED.includes(report?.output?.format ?? "") && weightOf(job, "model") <= MOST_BYTES) files.push({ side: "after", bytes: fetched("model") });
  return files;
}
