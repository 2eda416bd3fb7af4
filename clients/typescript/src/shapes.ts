// What the service takes and sends, by the names that this package gives it; generated.ts has all of it.
import type * as all from "./generated.js";

export type {
  BrowserToken,
  Capabilities,
  Inspection,
  Job,
  JobPage,
  JobProblem,
  JobReport,
  PartAccounting,
  NewBrowserToken,
  NewWebhookEndpoint,
  ObjectReport,
  ProblemCode,
  Progress,
  Readiness,
  Source,
  Stage,
  Status,
  Step,
  ThinPlace,
  ThinnestWall,
  Upload,
  WebhookDelivery,
  WebhookDeliveries,
  WebhookEndpoint,
  WebhookEndpointChange,
  WebhookEndpoints,
  WebhookMessage,
  WebhookSecret,
} from "./generated.js";

export type Artifact = all.ArtifactLink;
export type Outcome = all.JobOutcome;

/** What a job may be told. What is left out has the service's default. */
export type RepairOptions = Partial<all.Options>;
export type AnalyzeOptions = Partial<all.AnalyzeOptions>;
/** A mode, `repair` where it is left out, and that mode's options. */
export type JobOptions = ({ mode?: "repair" } & RepairOptions) | ({ mode: "analyze" } & AnalyzeOptions);
/** The same by names that nobody has looked at, such as those of an earlier job. */
export type Options = Record<string, unknown>;

/** The report of a repair. */
export type Report = all.Report & { mode: "repair" };
/** The report of an analysis. */
export type AnalysisReport = all.AnalysisReport & { mode: "analyze" };

/** A repair that ended with an outcome. */
export type RepairedJob = all.Job & { outcome: all.Outcome; report: Report };
/** An analysis that ended. */
export type AnalyzedJob = all.Job & { outcome: all.JobOutcome; report: AnalysisReport };

/** What an event `progress` says. */
export interface ProgressEvent extends all.Progress {
  status: all.Status;
}
