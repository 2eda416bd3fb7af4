import type { Job, ProblemCode } from "./shapes.js";

/** The service's error codes, and three codes of this package. A later service may send further codes. */
export type Code = ProblemCode | "unreachable" | "store_unreachable" | "unexplained" | (string & {});

/** One error of a request, and its field if the service names one. */
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

/** An error response of the service (RFC 9457), or the reason why there was no response. */
export class Problem extends Error {
  override readonly name = "Problem";

  constructor(
    readonly status: number,
    /** The service's error code, or `unreachable`, `store_unreachable` or `unexplained`, which this package adds. */
    readonly code: Code,
    readonly title: string,
    readonly detail: string,
    /** Seconds to wait before a retry, if the service states them. */
    readonly retryAfter: number | null = null,
    readonly requestId: string | null = null,
    /** The invalid fields of the request, and the error of each. */
    readonly errors: readonly FieldError[] = [],
  ) {
    super(detail || title || code);
  }

  /** Whether the same request may succeed later. */
  get isTransient(): boolean {
    return ["unreachable", "store_unreachable", "idempotency_key_in_use"].includes(this.code) || [429, 502, 503, 504].includes(this.status);
  }

  /** Creates the problem of a missing response, of the service or of its file store. */
  static unreachable(of: "service" | "store" = "service"): Problem {
    return new Problem(0, of === "store" ? "store_unreachable" : "unreachable", "", "");
  }

  /** Wraps any thrown value. */
  static from(error: unknown): Problem {
    return error instanceof Problem ? error : new Problem(0, "unexplained", String(error), "");
  }

  static of(status: number, body: string, retryAfter: string | null): Problem {
    const seconds = retryAfter === null ? null : Number.parseInt(retryAfter, 10);
    const wait = seconds !== null && Number.isFinite(seconds) ? seconds : null;
    try {
      const problem = JSON.parse(body) as Record<string, unknown>;
      const text = (name: string): string => (typeof problem[name] === "string" ? problem[name] : "");
      const errors = fieldErrors(problem["errors"]);
      if (text("code")) return new Problem(status, text("code"), text("title"), text("detail"), wait, text("request_id") || null, errors);
    } catch {
      // The body is not JSON, so a proxy responded.
    }
    return new Problem(status, "unexplained", `HTTP ${status}`, "", wait);
  }
}

/**
 * A job did not succeed: it failed, was canceled, or its files have expired. A job also fails if its result does not meet the option
 * `require`. Then `job.report` lists the remaining defects.
 */
export class JobFailed extends Error {
  override readonly name = "JobFailed";

  constructor(readonly job: Job) {
    super(job.problem?.detail ?? `The job '${job.id}' is ${job.status}.`);
  }
}

/** The SHA-256 of a downloaded file differs from the one in the job. */
export class DamagedDownload extends Error {
  override readonly name = "DamagedDownload";
}
