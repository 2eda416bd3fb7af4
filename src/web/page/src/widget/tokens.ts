import { type Server, Problem } from "meshmend-client";

/** Where a shop's page has its tokens from. */
export interface TokenSource {
  getToken: (() => Promise<string>) | null;
  token: string | null;
  tokenUrl: string | null;
}

interface Known {
  token: string;
  /** From when on another is asked for before something is begun with it; milliseconds since 1970. */
  staleAt: number;
}

/** A token should last for a job: so long before its end another is asked for, in milliseconds. */
const LONGEST_JOB = 15 * 60_000;

/** The browser tokens that the shop's backend gives: one is used until it is worth nothing any more. */
export class Tokens {
  #known: Known | null = null;

  constructor(readonly source: () => TokenSource) {}

  /** Forgets the token, since the shop gave another one. */
  forget(): void {
    this.#known = null;
  }

  /**
   * Asks the service something, and once more with another token where the first has expired. What it answers has the server as it was
   * asked: jobs are seen only with the token that they were submitted with. What was begun goes on with the server that it was begun with.
   */
  async asking<T>(base: string, signal: AbortSignal, ask: (server: Server) => Promise<T>, begun?: Server): Promise<{ answer: T; server: Server }> {
    try {
      const server = begun ?? serverOf(base, (await this.#fresh(signal)).token);
      return { answer: await ask(server), server };
    } catch (error) {
      const { getToken, tokenUrl } = this.source();
      const isWorthless = error instanceof Problem && error.code === "unauthorized";
      if (!isWorthless || !(getToken ?? tokenUrl)) throw error;
    }
    const server = serverOf(base, (await this.#get(signal, true)).token);
    return { answer: await ask(server), server };
  }

  async #fresh(signal: AbortSignal): Promise<Known> {
    const known = this.#known;
    return known && Date.now() < known.staleAt ? known : this.#get(signal, false);
  }

  async #get(signal: AbortSignal, again: boolean): Promise<Known> {
    const { getToken, token, tokenUrl } = this.source();
    const at = Date.now();
    let given: { token?: unknown; expires_at?: unknown };
    if (getToken) given = { token: await getToken().catch(refused) };
    else if (token && !again) given = { token };
    else if (tokenUrl) given = await fetchToken(tokenUrl, signal);
    else throw new Problem(0, "token_missing", "", "Set `token-url`, `token` or `getToken` on the element.");
    if (typeof given.token !== "string" || given.token === "") refused("The response contains no `token`.");
    const end = typeof given.expires_at === "string" ? Date.parse(given.expires_at) : Number.NaN;
    // A short one is used for half of its life.
    const staleAt = Number.isNaN(end) ? Infinity : Math.max(end - LONGEST_JOB, (at + end) / 2);
    return (this.#known = { token: given.token as string, staleAt });
  }
}

function serverOf(base: string, token: string): Server {
  return { base, key: () => token };
}

function refused(why: unknown): never {
  throw new Problem(0, "token_refused", "", why instanceof Error ? why.message : String(why));
}

/** Asks the shop's backend, as the customer's session. It answers as `POST /v1/browser-tokens` does. */
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
