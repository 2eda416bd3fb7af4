import type { FileItem } from "../state/items";
import { useWords } from "../words/locale";
import { Icon } from "./icons";

const ORDER = ["upload", "queue", "read", "inspect", "repair", "verify", "finish"] as const;
type Shown = (typeof ORDER)[number];

/** The stages of a file from upload to result, with the current stage. */
export function Stages({ item }: { item: Pick<FileItem, "phase" | "sent" | "bytes" | "progress"> }) {
  const { words, figures } = useWords();
  const { stage, tier, percent, queue_position } = item.progress ?? { stage: null, tier: null, percent: 0, queue_position: null };
  const now = at(item);
  const place = ORDER.indexOf(now);
  const detail = (name: Shown): string => {
    if (name !== now) return "";
    if (name === "upload") return words.uploaded(figures.bytes(item.sent), figures.bytes(item.bytes));
    if (name === "queue") return queue_position === null ? "" : words.queuePlace(queue_position);
    if (stage === "wait") return words.stages.wait;
    return tier ? (words.tiers[tier] ?? "") : "";
  };
  const share = now === "upload" ? item.sent / Math.max(1, item.bytes) : percent / 100;
  // Screen readers announce each stage and queue position, not each percent.
  const label = now === "queue" ? `${words.stages.queue} ${detail(now)}` : words.stages[now];
  return (
    <div class="stages">
      <div class="bar">
        <progress max={1} value={share} aria-label={words.percent} />
        <span class="percent">{figures.percent(share)}</span>
      </div>
      <ol>
        {ORDER.map((name, i) => (
          <li key={name} class={i < place ? "done" : i === place ? "now" : "next"} aria-current={i === place ? "step" : undefined}>
            <span class="knob">{i < place && <Icon name="check" size={14} />}</span>
            <span>{words.stages[name]}</span>
            <span class="detail">{detail(name)}</span>
          </li>
        ))}
      </ol>
      <p class="hidden" role="status">
        {label}
      </p>
    </div>
  );
}

function at(item: Pick<FileItem, "phase" | "progress">): Shown {
  if (item.phase !== "following") return item.phase === "submitting" ? "queue" : "upload";
  if (!item.progress || item.progress.status === "queued") return "queue";
  const { stage } = item.progress;
  if (stage === "wait") return "repair";
  return stage ?? "read";
}
