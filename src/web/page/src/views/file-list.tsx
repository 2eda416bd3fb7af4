import type { Capabilities } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { type FileItem, pauseUpload, remove, resume, selected } from "../state/items";
import { usePageWords } from "../words/page-locale";
import { ChooseFiles } from "./choose-files";
import { Icon, type IconName } from "./icons";

interface Props {
  items: FileItem[];
  chosen: number | null;
  take: (files: File[]) => void;
  can: Capabilities | null;
}

/** All files of this visit with their states. */
export function FileList({ items, chosen, take, can }: Props) {
  const { words } = usePageWords();
  return (
    <aside class="files" aria-label={words.files}>
      <ul>
        {items.map((item) => (
          <Row key={item.id} item={item} isChosen={item.id === chosen} />
        ))}
      </ul>
      <ChooseFiles can={can} take={take} compact />
    </aside>
  );
}

function Row({ item, isChosen }: { item: FileItem; isChosen: boolean }) {
  const { words, figures } = usePageWords();
  const { tone, icon, text, share } = stateOf(item, words, figures);
  return (
    <li class={isChosen ? `file chosen ${tone}` : `file ${tone}`}>
      <button type="button" class="pick" aria-current={isChosen ? "true" : undefined} onClick={() => selected.set(item.id)}>
        <span class="badge">{icon ? <Icon name={icon} size={16} /> : <span class="spinner" />}</span>
        <span class="text">
          <span class="name">{item.name}</span>
          <span class="state">{text}</span>
        </span>
      </button>
      {item.phase === "uploading" && (
        <button type="button" class="quiet" title={words.pauseNote} aria-label={`${words.pause}: ${item.name}`} onClick={() => pauseUpload(item.id)}>
          <Icon name="pause" size={16} />
        </button>
      )}
      {(item.phase === "paused" || (item.phase === "refused" && item.file && !item.job)) && (
        <button type="button" class="quiet" title={words.pauseNote} aria-label={`${words.resume}: ${item.name}`} onClick={() => resume(item.id)}>
          <Icon name="play" size={16} />
        </button>
      )}
      {!["uploading", "submitting"].includes(item.phase) && (
        <button type="button" class="quiet" aria-label={`${words.remove}: ${item.name}`} title={words.remove} onClick={() => remove(item.id)}>
          <Icon name="cross" size={16} />
        </button>
      )}
      {share !== null && <progress max={1} value={share} aria-label={`${words.percent}: ${item.name}`} />}
    </li>
  );
}

interface State {
  tone: "busy" | "good" | "fair" | "bad";
  icon: IconName | null;
  text: string;
  share: number | null;
}

type Said = ReturnType<typeof usePageWords>;

function stateOf(item: FileItem, words: Said["words"], figures: Said["figures"]): State {
  const busy = (text: string, share: number | null): State => ({ tone: "busy", icon: null, text, share });
  if (item.phase === "uploading") return busy(`${words.states.uploading} · ${figures.percent(item.sent / Math.max(1, item.bytes))}`, item.sent / Math.max(1, item.bytes));
  if (item.phase === "paused") return { tone: "fair", icon: "pause", text: words.states.paused, share: null };
  if (item.phase === "refused") return { tone: "bad", icon: "warn", text: words.states.refused, share: null };
  if (item.phase === "following") {
    const percent = item.progress?.percent ?? 0;
    const queued = item.progress?.status === "queued";
    return busy(queued ? words.states.queued : `${words.states.running} · ${figures.percent(percent / 100)}`, percent / 100);
  }
  if (item.phase !== "ended" || !item.job) return busy(words.states[item.phase === "waiting" ? "waiting" : "submitting"], null);
  const { status } = item.job;
  if (status === "canceled") return { tone: "fair", icon: "cross", text: words.outcomes["canceled"]!, share: null };
  if (status === "expired") return { tone: "fair", icon: "cross", text: words.statuses["expired"]!, share: null };
  const { tone, title } = claimsOf(item.job);
  return { tone, icon: tone === "good" ? "check" : "warn", text: words.outcomes[title] ?? "", share: null };
}
