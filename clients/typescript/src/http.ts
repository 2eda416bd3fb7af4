import { Problem } from "./problem";

/** Where the service is, and who asks. The page and the widget each make one. */
export interface Server {
  /** Its origin without a slash at the end; empty for the page's own. */
  readonly base: string;
  /** The API key or browser token to send, if any. */
  key(): string | null;
}

export interface Asked {
  method?: string;
  json?: unknown;
  headers?: Record<string, string>;
  signal?: AbortSignal;
}

/** Sends a request, and throws a `Problem` unless the answer is a success. */
export async function ask(server: Server, path: string, asked: Asked = {}): Promise<Response> {
  const headers: Record<string, string> = { ...asked.headers };
  const key = server.key();
  if (key) headers["authorization"] = `Bearer ${key}`;
  const init: RequestInit = { method: asked.method ?? "GET", headers, credentials: "omit" };
  if (asked.json !== undefined) {
    headers["content-type"] = "application/json";
    init.body = JSON.stringify(asked.json);
  }
  if (asked.signal) init.signal = asked.signal;
  let answer: Response;
  try {
    answer = await fetch(server.base + path, init);
  } catch (error) {
    if (asked.signal?.aborted) throw error;
    throw Problem.unreachable();
  }
  if (answer.ok) return answer;
  throw Problem.of(answer.status, await answer.text().catch(() => ""), answer.headers.get("retry-after"));
}

export async function askJson<T>(server: Server, path: string, asked: Asked = {}): Promise<T> {
  return (await (await ask(server, path, asked)).json()) as T;
}

/** Waits, unless the signal says stop. */
export function pause(milliseconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal?.addEventListener("abort", () => (clearTimeout(timer), reject(signal.reason)), { once: true });
  });
}
