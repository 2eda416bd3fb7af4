// Types of <meshmend-upload> for a shop's TypeScript. The file imports nothing, so it can be copied. See docs/widget.md.

/** Outcome of a job, as in the API. */
export type Outcome = "already_printable" | "repaired" | "partially_repaired" | "unrepairable";
export type Point = [number, number, number];

/** Numbers to price an order with. Verify them on your backend with `GET /v1/jobs/{id}`: the owner of the browser can change them here. */
export interface Metrics {
  /** Whether the model is closed, consistent and free of intersections: the outcome is `already_printable` or `repaired`. */
  printable: boolean;
  /** Whether the model meets every rule of the process; null without the option `process`. */
  printReady: boolean | null;
  /** The unit of the file's numbers, such as `mm` or `in`, and its source. `assumed` is a guess that a person should check. */
  unit: string;
  unitSource: "declared" | "file" | "assumed";
  /** Sides of the bounding box in millimetres, along x, y and z. */
  sizeMm: Point;
  /** Corners of the bounding box in millimetres. */
  boxMm: { min: Point; max: Point } | null;
  /** Null if the model is not closed. */
  volumeMm3: number | null;
  areaMm2: number | null;
  /** Null if there is no wall, as in a model that is not closed. */
  thinnestWallMm: number | null;
  /** Number of separate solids. */
  solids: number;
}

/** `uploaded`: the file has arrived and its job has been created. */
export interface UploadedDetail {
  jobId: string;
  status: "queued" | "running" | "succeeded" | "failed" | "canceled" | "expired";
  outcome: Outcome | null;
  name: string;
  bytes: number;
}

/** `progress`: the upload or the job advanced. Fires several times a second. */
export interface ProgressDetail {
  /** Null while the file is uploading. */
  jobId: string | null;
  status: "uploading" | "queued" | "running";
  outcome: null;
  /** Bytes sent, out of `bytes`. */
  sent: number;
  bytes: number;
  stage: "read" | "inspect" | "repair" | "wait" | "verify" | "finish" | null;
  /** Progress of the repair, 0 to 100. */
  percent: number;
  /** Number of jobs ahead in the queue. */
  queuePosition: number | null;
}

/** `repaired`: there is a result. It may not be printable: see `metrics.printable`. */
export interface RepairedDetail {
  jobId: string;
  status: "succeeded";
  outcome: "already_printable" | "repaired" | "partially_repaired";
  metrics: Metrics;
}

/** `chosen`: the customer took one of the job's alternatives. Only with the option `alternatives`. */
export interface ChosenDetail {
  jobId: string;
  /** The id of the result, for `GET /v1/jobs/{id}/artifacts/model?choice=`; `default` for the job's own result. */
  choice: string;
  /** The option in which the result differs from the default, as `name=value`. */
  option: string | null;
  printable: boolean;
  /** Whether the result meets all rules of the job's process; null without a process. */
  printReady: boolean | null;
  sizeMm: Point | null;
  volumeMm3: number | null;
  areaMm2: number;
  thinnestWallMm: number | null;
  /** Null if the density of the process's material is unknown. */
  weightG: number | null;
  parts: number;
}

/** `failed`: there is no result, and `code` says why. */
export interface FailedDetail {
  /** Null if no job was created. */
  jobId: string | null;
  status: "refused" | "succeeded" | "failed" | "canceled" | "expired";
  /** `unrepairable` or null; also `partially_repaired` if the job failed with `not_printable`. */
  outcome: Outcome | null;
  /** A code of the API (`/problems`), such as `not_printable` where the option `require` is `printable`, or `unrepairable`, `canceled`, `unreachable`, `store_unreachable` (a bucket whose CORS rules leave the page out), `token_missing`, `token_refused`, `bad_attribute`. */
  code: string;
  /** The message that the customer sees, in their language. */
  message: string;
  /** The detail from the service, in English. */
  detail: string;
}

export interface MeshmendUploadEventMap {
  uploaded: CustomEvent<UploadedDetail>;
  progress: CustomEvent<ProgressDetail>;
  repaired: CustomEvent<RepairedDetail>;
  chosen: CustomEvent<ChosenDetail>;
  failed: CustomEvent<FailedDetail>;
}

export interface MeshmendUploadElement extends HTMLElement {
  /** Returns a token whenever one is needed; takes precedence over the attributes `token` and `token-url`. */
  getToken: (() => Promise<string>) | null;
  /** Id of the current job. */
  readonly jobId: string | null;
  /** Id of the result that the customer chose; `default` until then. */
  readonly choice: string;
  /** Uploads a file, as if the customer had dropped it. */
  upload(file: File): void;
  /** Stops the current upload and shows the drop zone again. */
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
