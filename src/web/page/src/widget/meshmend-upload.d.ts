// What a shop's TypeScript needs to know of <meshmend-upload>. It imports nothing, so that the file can be copied. See docs/widget.md.

/** A job's outcome, as the API has it. */
export type Outcome = "already_printable" | "repaired" | "partially_repaired" | "unrepairable";
export type Point = [number, number, number];

/** What prices an order. Check it on your backend with the numbers of `GET /v1/jobs/{id}`: whoever owns the browser can change these. */
export interface Metrics {
  /** Whether the model is closed, consistent and free of intersections: the outcome is `already_printable` or `repaired`. */
  printable: boolean;
  /** The unit of the file's numbers, such as `mm` or `in`, and who said so; `assumed` is a guess that a person should look at. */
  unit: string;
  unitSource: "declared" | "file" | "assumed";
  /** The bounding box's sides in millimetres, along x, y and z. */
  sizeMm: Point;
  /** Its corners in millimetres. */
  boxMm: { min: Point; max: Point } | null;
  /** Null where the model is not closed. */
  volumeMm3: number | null;
  areaMm2: number | null;
  /** Null where there is none, as in a model that is not closed. */
  thinnestWallMm: number | null;
  /** Separate bodies. */
  solids: number;
}

/** `uploaded`: the file has arrived and its job is made. */
export interface UploadedDetail {
  jobId: string;
  status: "queued" | "running" | "succeeded" | "failed" | "canceled" | "expired";
  outcome: Outcome | null;
  name: string;
  bytes: number;
}

/** `progress`: something goes on, several times a second. */
export interface ProgressDetail {
  /** Null while the file is on its way. */
  jobId: string | null;
  status: "uploading" | "queued" | "running";
  outcome: null;
  /** Bytes that have gone, of how many. */
  sent: number;
  bytes: number;
  stage: "read" | "inspect" | "repair" | "wait" | "verify" | "finish" | null;
  /** 0 to 100, of the repair. */
  percent: number;
  /** Jobs that come first. */
  queuePosition: number | null;
}

/** `repaired`: there is a result. Not each can be printed: see `metrics.printable`. */
export interface RepairedDetail {
  jobId: string;
  status: "succeeded";
  outcome: "already_printable" | "repaired" | "partially_repaired";
  metrics: Metrics;
}

/** `failed`: there is no result, and why. */
export interface FailedDetail {
  /** Null where there was no job yet. */
  jobId: string | null;
  status: "refused" | "succeeded" | "failed" | "canceled" | "expired";
  /** `unrepairable`, where the job failed with `not_printable` also `partially_repaired`, or null. */
  outcome: Outcome | null;
  /** A code of the API (`/problems`), such as `not_printable` where the option `require` is `printable`, or `unrepairable`, `canceled`, `unreachable`, `store_unreachable` (a bucket whose CORS rules leave the page out), `token_missing`, `token_refused`, `bad_attribute`. */
  code: string;
  /** What the widget says to the customer, in their language. */
  message: string;
  /** The service's own words. */
  detail: string;
}

export interface MeshmendUploadEventMap {
  uploaded: CustomEvent<UploadedDetail>;
  progress: CustomEvent<ProgressDetail>;
  repaired: CustomEvent<RepairedDetail>;
  failed: CustomEvent<FailedDetail>;
}

export interface MeshmendUploadElement extends HTMLElement {
  /** Gives a token whenever one is needed; goes before the attributes `token` and `token-url`. */
  getToken: (() => Promise<string>) | null;
  /** The present job's id. */
  readonly jobId: string | null;
  /** Uploads a file, as if it had been dropped. */
  upload(file: File): void;
  /** Stops what goes on and begins anew, with the drop zone. */
  reset(): void;

  addEventListener<K extends keyof MeshmendUploadEventMap>(
    type: K,
    listener: (this: MeshmendUploadElement, event: MeshmendUploadEventMap[K]) => void,
    options?: boolean | AddEventListenerOptions,
  ): void;
  addEventListener<K extends keyof HTMLElementEventMap>(
    type: K,
    listener: (this: HTMLElement, event: HTMLElementEventMap[K]) => void,
    options?: boolean | AddEventListenerOptions,
  ): void;
  addEventListener(type: string, listener: EventListenerOrEventListenerObject, options?: boolean | AddEventListenerOptions): void;
}

declare global {
  interface HTMLElementTagNameMap {
    "meshmend-upload": MeshmendUploadElement;
  }
}
