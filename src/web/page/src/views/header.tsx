import { route } from "../state/route";
import { key, connect } from "../state/server";
import { type Theme, choose, settings } from "../state/settings";
import { usePageWords } from "../words/page-locale";
import { LANGUAGES, type Language } from "../words/locale";
import { Icon, type IconName, Logo } from "./icons";
import { useStore } from "./use-store";

const THEMES: [Theme, IconName][] = [
  ["auto", "auto"],
  ["light", "sun"],
  ["dark", "moon"],
];

export function Header() {
  const { words } = usePageWords();
  const where = useStore(route);
  const { language, theme } = useStore(settings);
  const secret = useStore(key);
  const forget = (): void => {
    key.set(null);
    void connect();
  };
  const at = THEMES.findIndex(([name]) => name === theme);
  const [next] = THEMES[(at + 1) % THEMES.length]!;
  const [, icon] = THEMES[at]!;
  return (
    <header class="top">
      <a class="brand" href="#/">
        <Logo />
        <span>meshmend</span>
      </a>
      <nav aria-label={words.nav}>
        <a href="#/" aria-current={where.at === "repair" ? "page" : undefined}>
          {words.repair}
        </a>
        <a href="#/jobs" aria-current={where.at !== "repair" ? "page" : undefined}>
          {words.jobs}
        </a>
        <a href="/docs/">{words.docs}</a>
      </nav>
      <div class="tools">
        {secret && (
          <button type="button" class="quiet" onClick={forget} title={words.keyForget} aria-label={words.keyForget}>
            <Icon name="key" />
          </button>
        )}
        <button
          type="button"
          class="quiet"
          onClick={() => choose({ theme: next })}
          title={`${words.theme}: ${words.themes[theme]}`}
          aria-label={`${words.theme}: ${words.themes[theme]}`}
        >
          <Icon name={icon} />
        </button>
        <select
          class="quiet"
          aria-label={words.language}
          value={language}
          onChange={(event) => choose({ language: event.currentTarget.value as Language })}
        >
          {Object.entries(LANGUAGES).map(([code, { name }]) => (
            <option key={code} value={code}>
              {name}
            </option>
          ))}
        </select>
      </div>
    </header>
  );
}
