import { useEffect, useState } from "preact/hooks";
import { type Capabilities, type Readiness, Problem, metrics, readiness } from "meshmend-client";
import { readMetrics, valueOf } from "../report/metrics";
import { server } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { Facts } from "./facts";
import { Icon } from "./icons";

const AGAIN_MS = 5000;

interface Seen {
  ready: Readiness | null;
  queued: number | null;
  running: number | null;
  wait: number | null;
  /** Whether the key may read the metrics. */
  open: boolean;
}

async function look(): Promise<Seen> {
  const ready = await readiness(server).catch(() => null);
  const none = { ready, queued: null, running: null, wait: null };
  try {
    const samples = readMetrics(await metrics(server));
    const jobs = (status: string): number | null => valueOf(samples, "meshmend_jobs", { status });
    return { ready, queued: jobs("queued") ?? 0, running: jobs("running") ?? 0, wait: valueOf(samples, "meshmend_queue_wait_seconds"), open: true };
  } catch (error) {
    return { ...none, open: !(error instanceof Problem && (error.status === 401 || error.status === 403)) };
  }
}

/** The health of the service, its queue and its tiers. */
export function Health({ can }: { can: Capabilities | null }) {
  const { words, figures } = usePageWords();
  const [seen, setSeen] = useState<Seen | null>(null);
  useEffect(() => {
    let timer = 0;
    let isFileGone = false;
    const again = async (): Promise<void> => {
      if (document.visibilityState === "visible") {
        const now = await look();
        if (isFileGone) return;
        setSeen(now);
      }
      timer = window.setTimeout(() => void again(), AGAIN_MS);
    };
    void again();
    return () => {
      isFileGone = true;
      clearTimeout(timer);
    };
  }, []);
  const ready = seen?.ready?.ready;
  // Blender's check is shown with the tiers.
  const checks = Object.entries(seen?.ready?.checks ?? {}).filter(([name]) => name !== "blender");
  return (
    <aside class="card health" aria-label={words.health}>
      <h2 class={ready === false || (seen && !seen.ready) ? "bad" : "good"}>
        <Icon name={ready === false || (seen && !seen.ready) ? "warn" : "check"} /> {seen ? (ready ? words.ready : words.notReady) : words.health}
      </h2>
      <h3>{words.queue}</h3>
      {seen && !seen.open ? (
        <p class="aside">{words.noMetrics}</p>
      ) : (
        <Facts
          look="counts"
          list={[
            [words.waitingJobs, seen?.queued == null ? "–" : figures.count(seen.queued)],
            [words.runningJobs, seen?.running == null ? "–" : figures.count(seen.running)],
            [words.longestWait, seen?.wait == null ? "–" : figures.seconds(seen.wait * 1000)],
          ]}
        />
      )}
      <h3>{words.repair}</h3>
      <ul>
        {(can?.tiers ?? []).map((tier) => (
          <li key={tier.tier} class={tier.available ? "good" : "fair"}>
            <Icon name={tier.available ? "check" : "warn"} size={16} />
            <span>
              {tier.tier}. {words.tierNames[tier.tier] ?? tier.name}: {tier.available ? words.available : words.unavailable}
              <span class="aside">{tier.program ? ` ${tier.program.kind} ${tier.program.version}` : tier.detail ? ` ${tier.detail}` : ""}</span>
            </span>
          </li>
        ))}
      </ul>
      <h3>{words.checks}</h3>
      <ul>
        {checks.map(([name, state]) => (
          <li key={name} class={state === "ok" ? "good" : "fair"}>
            <Icon name={state === "ok" ? "check" : "warn"} size={16} />
            <span>
              {name}: {state}
            </span>
          </li>
        ))}
      </ul>
      {can && <p class="aside">{can.engine}</p>}
    </aside>
  );
}
