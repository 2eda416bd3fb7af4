import { type Job, type NewJob, type Options, type ProgressEvent, Problem, announce, cancelJob, follow, getJob, send, standing, submitWithRetry } from "meshmend-client";
import { firstOptions } from "./profiles";
import { lockIfUnauthorized, server } from "./server";
import { Store } from "./store";

/** The state of one file. */
export type Phase = "waiting" | "uploading" | "paused" | "submitting" | "following" | "ended" | "refused";

export interface FileItem {
  id: number;
  name: string;
  bytes: number;
  /** Null for a job that was opened by its address: the page never had its file. */
  file: File | null;
  /** The options of the job. */
  options: Options;
  phase: Phase;
  sent: number;
  progress: ProgressEvent | null;
  job: Job | null;
  problem: Problem | null;
}

/** Files that upload at the same time. The next file uploads while earlier ones are repaired. */
const MAX_UPLOADS = 2;

/** The files of this visit, from drop to result. */
export const items = new Store<FileItem[]>([]);
export const selected = new Store<number | null>(null);

const stops = new Map<number, AbortController>();
let last = 0;

function update(id: number, change: Partial<FileItem>): void {
  items.change((all) => all.map((item) => (item.id === id ? { ...item, ...change } : item)));
}

function newItem(name: string, bytes: number, file: File | null): FileItem {
  last += 1;
  return { id: last, name, bytes, file, options: {}, phase: "waiting", sent: 0, progress: null, job: null, problem: null };
}

export function find(id: number): FileItem | undefined {
  return items.value.find((item) => item.id === id);
}

export function add(files: readonly File[]): void {
  if (files.length === 0) return;
  const added = files.map((file) => ({ ...newItem(file.name, file.size, file), options: firstOptions() }));
  items.change((all) => [...all, ...added]);
  selected.set(added[0]!.id);
  startUploads();
}

/** Shows an existing job. */
export function open(id: string): void {
  const there = items.value.find((item) => item.job?.id === id);
  if (there) return selected.set(there.id);
  const opened: FileItem = { ...newItem(id, 0, null), phase: "submitting" };
  items.change((all) => [...all, opened]);
  selected.set(opened.id);
  void run(opened.id, async (signal) => followJob(opened.id, await getJob(server, id, signal), signal));
}

/** Problem codes that mean the service no longer has the file of the earlier job. */
const FILE_IS_GONE = ["job_expired", "job_deleted", "job_not_found"];
/** HTTP statuses for refused options. */
const REFUSED_OPTIONS = [400, 422];

/**
 * Submits another job for the file of an earlier job, with other options. If the service no longer has the file, the page sends it
 * again. Throws if the service refuses the options, so that a form can show why.
 */
export async function again(earlier: Job, options: Options): Promise<void> {
  const file = fileOf(earlier);
  const next: FileItem = { ...newItem(earlier.input.name, earlier.input.bytes, file), options, phase: "submitting" };
  const show = (change: Partial<FileItem>): void => {
    items.change((all) => [...all, { ...next, ...change }]);
    selected.set(next.id);
  };
  try {
    const job = await submitWithRetry(server, { source: { job_id: earlier.id }, options });
    show({});
    void run(next.id, (signal) => followJob(next.id, job, signal));
  } catch (error) {
    const problem = Problem.from(error);
    lockIfUnauthorized(problem);
    if (REFUSED_OPTIONS.includes(problem.status)) throw problem;
    show(file && isFileGone(problem) ? { phase: "waiting" } : { phase: "refused", problem });
    startUploads();
  }
}

/** Submits a file that the page created, such as a scaled copy, or that the user chose again. */
export function sendFile(file: File, options: Options): void {
  const next: FileItem = { ...newItem(file.name, file.size, file), options };
  items.change((all) => [...all, next]);
  selected.set(next.id);
  startUploads();
}

/** The file of a job that was uploaded during this visit. */
export function fileOf(job: Job): File | null {
  return items.value.find((item) => item.job?.id === job.id)?.file ?? null;
}

/** Whether a job could not be created because the service has deleted the file of the earlier job. */
export function isFileGone(error: unknown): boolean {
  return error instanceof Problem && FILE_IS_GONE.includes(error.code);
}

export function pauseUpload(id: number): void {
  stops.get(id)?.abort();
  update(id, { phase: "paused" });
}

/** Sends the file from its start again: an upload is one request. `file` replaces the earlier file. */
export function resume(id: number, file?: File): void {
  update(id, { phase: "waiting", sent: 0, problem: null, ...(file && { file, bytes: file.size }) });
  startUploads();
}

export async function stop(id: number): Promise<void> {
  const item = find(id);
  if (item?.phase === "following" && item.job) await cancelJob(server, item.job.id).catch((error: unknown) => fail(id, error));
  else remove(id);
}

export function remove(id: number): void {
  stops.get(id)?.abort();
  items.change((all) => all.filter((item) => item.id !== id));
  if (selected.value === id) selected.set(items.value.at(-1)?.id ?? null);
  startUploads();
}

function startUploads(): void {
  const busy = items.value.filter((item) => item.phase === "uploading").length;
  for (const next of items.value.filter((item) => item.phase === "waiting").slice(0, Math.max(0, MAX_UPLOADS - busy))) {
    update(next.id, { phase: "uploading" });
    void run(next.id, (signal) => upload(next, signal));
  }
}

async function run(id: number, work: (signal: AbortSignal) => Promise<void>): Promise<void> {
  const stop = new AbortController();
  stops.set(id, stop);
  try {
    await work(stop.signal);
  } catch (error) {
    if (!stop.signal.aborted) fail(id, error);
  } finally {
    if (stops.get(id) === stop) stops.delete(id);
    startUploads();
  }
}

function fail(id: number, error: unknown): void {
  const problem = Problem.from(error);
  lockIfUnauthorized(problem);
  update(id, { phase: "refused", problem });
}

async function upload(item: FileItem, signal: AbortSignal): Promise<void> {
  const { id, file } = item;
  if (!file) return;
  const place = await announce(server, file.name, file.size, signal);
  await send(server, place, file, (sent) => update(id, { sent }), signal);
  update(id, { phase: "submitting", sent: file.size });
  // The next file can upload now.
  startUploads();
  await createJob(id, { source: { upload_id: place.id }, options: item.options }, signal);
}

async function createJob(id: number, asked: NewJob, signal: AbortSignal): Promise<void> {
  await followJob(id, await submitWithRetry(server, asked, signal), signal);
}

async function followJob(id: number, job: Job, signal: AbortSignal): Promise<void> {
  update(id, { phase: "following", job, name: job.input.name, bytes: job.input.bytes, progress: standing(job) });
  const ended = await follow(server, job.id, (progress) => update(id, { progress }), signal);
  update(id, { phase: "ended", job: ended, progress: null });
}
