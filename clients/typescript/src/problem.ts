import type { Job, ProblemCode } from "./shapes.js";

/** The codes of the service, and three of ours; a later service may have more. */
export type Code = ProblemCode | "unreachable" | "store_unreachable" | "unexplained" | (string & {});

/** One of several errors of a request, and the field that it is about, where the service names one. */
export interface FieldError {
  field: string | null;
  message: string;
}

/** Reads `errors` of a problem: a list of texts, or of objects with `field` and `message`. */
export function fieldErrors(errors: unknown): FieldError[] {
  if (!Array.isArray(errors)) return [];
  return errors.map((error: unknown): FieldError => {
    if (typeof error !== "object" || error === null) return { field: null, message: String(error) };
    const { field, message, detail } = error as Record<string, unknown>;
    return { field: typeof field === "string" ? field : null, message: String(message ?? detail ?? "") };
  });
}

/** Why the service refused or failed, in its own words (RFC 9457), or in ours where it said nothing. */
export class Problem extends Error {
  override readonly name = "Problem";

  constructor(
    readonly status: number,
    /** The service's code; `unreachable`, `store_unreachable` and `unexplained` are ours. */
    readonly code: Code,
    readonly title: string,
    readonly detail: string,
    /** Seconds after which to try again, if it said so. */
    readonly retryAfter: number | null = null,
    readonly requestId: string | null = null,
    /** Single errors, where there are several or the service names their fields. */
    readonly errors: readonly FieldError[] = [],
  ) {
    super(detail || title || code);
  }

  /** Whether the same request may work a little later. */
  get isPassing(): boolean {
    return ["unreachable", "store_unreachable", "idempotency_key_in_use"].includes(this.code) || [429, 502, 503, 504].includes(this.status);
  }

  /** No answer came: of the service, or of the store that its files go to. */
  static unreachable(of: "service" | "store" = "service"): Problem {
    return new Problem(0, of === "store" ? "store_unreachable" : "unreachable", "", "");
  }

  /** Of whatever was thrown. */
  static from(error: unknown): Problem {
    return error instanceof Problem ? error : new Problem(0, "unexplained", String(error), "");
  }

  static of(status: number, body: string, retryAfter: string | null): Problem {
    const seconds = retryAfter === null ? null : Number.parseInt(retryAfter, 10);
    const wait = seconds !== null && Number.isFinite(seconds) ? seconds : null;
    try {
      const it = JSON.parse(body) as Record<string, unknown>;
      const text = (name: string): string => (typeof it[name] === "string" ? it[name] : "");
      const errors = fieldErrors(it["errors"]);
      if (text("code")) return new Problem(status, text("code"), text("title"), text("detail"), wait, text("request_id") || null, errors);
    } catch {
      // Not JSON: some proxy's page.
    }
    return new Problem(status, "unexplained", `HTTP ${status}`, "", wait);
  }
}

/**
 * That a job ended without a result: it failed, was canceled, or its files are gone. With the option `require` it also fails where its
 * result is not what was required; then `job.report` says what is left.
 */
export class JobFailed extends Error {
  override readonly name = "JobFailed";

  constructor(readonly job: Job) {
    super(job.problem?.detail ?? `The job '${job.id}' is ${job.status}.`);
  }
}

/** That bytes are not those that the job names. */
export class DamagedDownload extends Error {
  override readonly name = "DamagedDownload";
}
