import type { paths } from "./generated.js";
import { Problem } from "./problem.js";

/** The address of the service and the key for it. A `Client` implements it. */
export interface Server {
  /** URL of the service without a slash at the end; empty for the page's own origin. */
  readonly base: string;
  /** The API key or browser token to send, if any. */
  key(): string | null;
}

export interface Asked {
  method?: string;
  json?: unknown;
  /** Files to send. */
  form?: FormData;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
}

/** Time limit in milliseconds until a response begins. Requests with files have no limit. */
const TIMEOUT = 60_000;

/** Returns a path of the service with its parameters filled in. */
export function at(template: keyof paths, values: Record<string, string> = {}): string {
  return template.replace(/\{(\w+)\}/g, (_, name: string) => encodeURIComponent(values[name] ?? ""));
}

/** Adds a query to a path, without undefined or empty values. */
export function query(path: string, values: Record<string, string | number | null | undefined>): string {
  const given = Object.entries(values).filter(([, value]) => value !== undefined && value !== null && value !== "");
  return given.length === 0 ? path : `${path}?${new URLSearchParams(given.map(([name, value]) => [name, String(value)]))}`;
}

/** Sends a request. Throws a `Problem` unless the request succeeds. */
export async function ask(server: Server, path: string, asked: Asked = {}): Promise<Response> {
  const headers: Record<string, string> = { ...asked.headers };
  const key = server.key();
  if (key) headers["authorization"] = `Bearer ${key}`;
  const init: RequestInit = { method: asked.method ?? "GET", headers, credentials: "omit" };
  if (asked.json !== undefined) {
    headers["content-type"] = "application/json";
    init.body = JSON.stringify(asked.json);
  }
  if (asked.form) init.body = asked.form;
  const late = new AbortController();
  const timer = asked.form ? undefined : setTimeout(() => late.abort(), TIMEOUT);
  init.signal = asked.signal ? AbortSignal.any([asked.signal, late.signal]) : late.signal;
  let answer: Response;
  try {
    answer = await fetch(server.base + path, init);
  } catch {
    if (asked.signal?.aborted) throw asked.signal.reason;
    throw Problem.unreachable();
  } finally {
    clearTimeout(timer);
  }
  if (answer.ok) return answer;
  throw Problem.of(answer.status, await answer.text().catch(() => ""), answer.headers.get("retry-after"));
}

export async function askJson<T>(server: Server, path: string, asked: Asked = {}): Promise<T> {
  const answer = await ask(server, path, asked);
  try {
    return (await answer.json()) as T;
  } catch (error) {
    if (asked.signal?.aborted) throw asked.signal.reason;
    // The connection broke, or a proxy responded instead of the service.
    throw error instanceof SyntaxError ? new Problem(answer.status, "unexplained", "The response is not JSON.", "") : Problem.unreachable();
  }
}
