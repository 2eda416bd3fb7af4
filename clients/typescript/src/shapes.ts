// The JSON types of the API under the names of this package. generated.ts has all types.
import type * as all from "./generated.js";

export type {
  Alternative,
  Alternatives,
  BrowserToken,
  Capabilities,
  Inspection,
  Job,
  JobPage,
  JobProblem,
  JobReport,
  PartAccounting,
  PrintReadiness,
  PrintRule,
  ProcessLimits,
  ProcessProfile,
  ProcessProfiles,
  NewBrowserToken,
  NewWebhookEndpoint,
  NotOffered,
  ObjectReport,
  OpenQuestion,
  ProblemCode,
  Progress,
  Readiness,
  RuleResult,
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

/** Options of a repair. Missing options have the service's defaults. */
export type RepairOptions = Partial<all.Options>;
export type AnalyzeOptions = Partial<all.AnalyzeOptions>;
/** `mode`, which is `repair` by default, and the options of that mode. */
export type JobOptions = ({ mode?: "repair" } & RepairOptions) | ({ mode: "analyze" } & AnalyzeOptions);
/** Options whose names are not checked, such as those of an earlier job. */
export type Options = Record<string, unknown>;

/** The report of a repair. */
export type Report = all.Report & { mode: "repair" };
/** The report of an analysis. */
export type AnalysisReport = all.AnalysisReport & { mode: "analyze" };

/** An ended repair with an outcome. */
export type RepairedJob = all.Job & { outcome: all.Outcome; report: Report };
/** An ended analysis. */
export type AnalyzedJob = all.Job & { outcome: all.JobOutcome; report: AnalysisReport };

/** Data of the event `progress`. */
export interface ProgressEvent extends all.Progress {
  status: all.Status;
}
