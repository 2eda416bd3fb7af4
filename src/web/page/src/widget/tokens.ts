import { type Server, Problem } from "meshmend-client";

/** Where a shop's page gets its tokens from. */
export interface TokenSource {
  getToken: (() => Promise<string>) | null;
  token: string | null;
  tokenUrl: string | null;
}

interface Known {
  token: string;
  /** Time after which a new token is fetched before a new upload, in milliseconds since 1970. */
  staleAt: number;
}

/** A token should outlast a job: a new one is fetched this many milliseconds before it expires. */
const LONGEST_JOB = 15 * 60_000;

/** Browser tokens from the shop's backend. A token is reused until it expires. */
export class Tokens {
  #known: Known | null = null;

  constructor(readonly source: () => TokenSource) {}

  /** Forgets the token, because the shop has set another one. */
  forget(): void {
    this.#known = null;
  }

  /**
   * Sends a request, and retries once with a new token if the first has expired. The answer includes the server with its token, because
   * only the token that submitted a job can see the job. With `current`, the request uses that server first.
   */
  async request<T>(base: string, signal: AbortSignal, send: (server: Server) => Promise<T>, current?: Server): Promise<{ answer: T; server: Server }> {
    try {
      const server = current ?? serverOf(base, (await this.#fresh(signal)).token);
      return { answer: await send(server), server };
    } catch (error) {
      const { getToken, tokenUrl } = this.source();
      const isExpired = error instanceof Problem && error.code === "unauthorized";
      if (!isExpired || !(getToken ?? tokenUrl)) throw error;
    }
    const server = serverOf(base, (await this.#get(signal, true)).token);
    return { answer: await send(server), server };
  }

  async #fresh(signal: AbortSignal): Promise<Known> {
    const known = this.#known;
    return known && Date.now() < known.staleAt ? known : this.#get(signal, false);
  }

  async #get(signal: AbortSignal, isRetry: boolean): Promise<Known> {
    const { getToken, token, tokenUrl } = this.source();
    const now = Date.now();
    let response: { token?: unknown; expires_at?: unknown };
    if (getToken) response = { token: await getToken().catch(refused) };
    else if (token && !isRetry) response = { token };
    else if (tokenUrl) response = await fetchToken(tokenUrl, signal);
    else throw new Problem(0, "token_missing", "", "Set `token-url`, `token` or `getToken` on the element.");
    if (typeof response.token !== "string" || response.token === "") refused("The response contains no `token`.");
    const end = typeof response.expires_at === "string" ? Date.parse(response.expires_at) : Number.NaN;
    // A short-lived token is used for half of its life.
    const staleAt = Number.isNaN(end) ? Infinity : Math.max(end - LONGEST_JOB, (now + end) / 2);
    return (this.#known = { token: response.token as string, staleAt });
  }
}

function serverOf(base: string, token: string): Server {
  return { base, key: () => token };
}

function refused(reason: unknown): never {
  throw new Problem(0, "token_refused", "", reason instanceof Error ? reason.message : String(reason));
}

/** Fetches a token from the shop's backend, with the customer's session. The response has the form of `POST /v1/browser-tokens`. */
async function fetchToken(url: string, signal: AbortSignal): Promise<{ token?: unknown; expires_at?: unknown }> {
  try {
    const answer = await fetch(url, { method: "POST", headers: { accept: "application/json" }, credentials: "same-origin", signal });
    if (!answer.ok) throw new Error(`${url} responded with status ${answer.status}.`);
    return (await answer.json()) as { token?: unknown };
  } catch (error) {
    signal.throwIfAborted();
    return refused(error);
  }
}
