export { Client, type Call, type ClientOptions, type JobRef, type Model, type Submit, type Wait, artifactOf } from "./client.js";
export { EventParser, type JobEvent, events, follow, hasEnded, standing } from "./events.js";
export { type Asked, type Server, ask, askJson } from "./http.js";
export * from "./jobs.js";
export { type Code, DamagedDownload, type FieldError, JobFailed, Problem, fieldErrors } from "./problem.js";
export { retryWithBackoff, pause } from "./retry.js";
export type * from "./shapes.js";
export { announce, send } from "./uploads.js";
export type { Webhooks } from "./webhooks.js";
