/** Why the service refused or failed, in its own words (RFC 9457), or in ours where it said nothing. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    /** The service's code; `unreachable` and `unexplained` are ours. */
    readonly code: string,
    readonly title: string,
    readonly detail: string,
    /** Seconds after which to try again, if it said so. */
    readonly retryAfter: number | null = null,
    readonly requestId: string | null = null,
  ) {
    super(detail || title);
  }

  /** Whether the same request may work a little later. */
  get isPassing(): boolean {
    return this.code === "unreachable" || this.status === 429 || this.status === 502 || this.status === 503 || this.status === 504;
  }

  static unreachable(): Problem {
    return new Problem(0, "unreachable", "", "");
  }

  static of(status: number, body: string, retryAfter: string | null): Problem {
    const seconds = retryAfter === null ? null : Number.parseInt(retryAfter, 10);
    const wait = seconds !== null && Number.isFinite(seconds) ? seconds : null;
    try {
      const it = JSON.parse(body) as Record<string, unknown>;
      const text = (name: string): string => (typeof it[name] === "string" ? it[name] : "");
      if (text("code")) return new Problem(status, text("code"), text("title"), text("detail"), wait, text("request_id") || null);
    } catch {
      // Not JSON: some proxy's page.
    }
    return new Problem(status, "unexplained", `HTTP ${status}`, "", wait);
  }
}
