// Icons drawn on a 20 by 20 grid with one stroke. They are decorative: a text or label beside each has the meaning.
const PATHS = {
  upload: "M10 13V3.5M6 7l4-4 4 4M3.5 13.5v2a1.5 1.5 0 0 0 1.5 1.5h10a1.5 1.5 0 0 0 1.5-1.5v-2",
  download: "M10 3v9.5M6 9l4 4 4-4M3.5 13.5v2A1.5 1.5 0 0 0 5 17h10a1.5 1.5 0 0 0 1.5-1.5v-2",
  check: "M4 10.5l4 4 8-9",
  warn: "M10 3.2 17.6 16.5H2.4zM10 8v4M10 14.2v.1",
  cross: "M5 5l10 10M15 5 5 15",
  pause: "M7 4.5v11M13 4.5v11",
  play: "M6 4l10 6-10 6z",
  plus: "M10 4v12M4 10h12",
  target: "M10 6.5a3.5 3.5 0 1 0 0 7 3.5 3.5 0 0 0 0-7M10 2v3M10 15v3M2 10h3M15 10h3",
  eye: "M1.8 10S4.8 4.5 10 4.5 18.2 10 18.2 10 15.2 15.5 10 15.5 1.8 10 1.8 10zM10 7.6a2.4 2.4 0 1 0 0 4.8 2.4 2.4 0 0 0 0-4.8",
  hidden: "M3 3l14 14M8 4.8A8 8 0 0 1 10 4.5c5.2 0 8.2 5.5 8.2 5.5a14 14 0 0 1-2.6 3.2M5 6.3A14 14 0 0 0 1.8 10S4.8 15.5 10 15.5a8 8 0 0 0 3.4-.7",
  home: "M4.2 12.5a6.2 6.2 0 1 0 .6-5.6M4 3v4h4",
  wire: "M10 2.5 17 6.3v7.4L10 17.5 3 13.7V6.3zM3 6.3l7 3.9 7-3.9M10 10.2v7.3",
  ruler: "M2.5 13.5 13.5 2.5l4 4-11 11zM6 10l1.6 1.6M8.7 7.3l2.2 2.2M11.4 4.6 13 6.2",
  slice: "M3 12.5 10 16l7-3.5M3 7.5 10 4l7 3.5-7 3.5zM2 17 18 3",
  moon: "M16.5 12A7 7 0 0 1 8 3.5a7 7 0 1 0 8.5 8.5z",
  sun: "M10 6.2a3.8 3.8 0 1 0 0 7.6 3.8 3.8 0 0 0 0-7.6M10 1.8v1.6M10 16.6v1.6M1.8 10h1.6M16.6 10h1.6M4.2 4.2l1.1 1.1M14.7 14.7l1.1 1.1M15.8 4.2l-1.1 1.1M5.3 14.7l-1.1 1.1",
  auto: "M10 3a7 7 0 1 0 0 14zM10 3a7 7 0 0 1 0 14",
  arrow: "M12.5 4.5 7 10l5.5 5.5",
  key: "M12.5 3.5a4 4 0 1 0 0 8 4 4 0 0 0 0-8M9.6 10.4 3 17M5 15l2 2",
  full: "M3 8V3h5M17 8V3h-5M3 12v5h5M17 12v5h-5",
  folder: "M2.5 5.5A1.5 1.5 0 0 1 4 4h3.5l2 2H16a1.5 1.5 0 0 1 1.5 1.5v7A1.5 1.5 0 0 1 16 16H4a1.5 1.5 0 0 1-1.5-1.5z",
  copy: "M7 7V4.5A1.5 1.5 0 0 1 8.5 3h7A1.5 1.5 0 0 1 17 4.5v7a1.5 1.5 0 0 1-1.5 1.5H13M4.5 7h7A1.5 1.5 0 0 1 13 8.5v7a1.5 1.5 0 0 1-1.5 1.5h-7A1.5 1.5 0 0 1 3 15.5v-7A1.5 1.5 0 0 1 4.5 7z",
  distance: "M3 4v12M17 4v12M3 10h14M6 7l-3 3 3 3M14 7l3 3-3 3",
  palette: "M10 3a7 7 0 1 0 0 14c1.4 0 1.7-.9 1.2-1.8-.6-1.1.1-2.2 1.3-2.2H15a2 2 0 0 0 2-2.2C16.7 6.400 13.700 3 10 3zM6.500 9.500v.1M9 6.500v.1M12.800 7.500v.1",
  sparkle: "M10 2.5l1.8 5.7 5.7 1.8-5.7 1.8L10 17.5l-1.8-5.7L2.5 10l5.7-1.8z",
} as const;

export type IconName = keyof typeof PATHS;

export function Icon({ name, size = 18 }: { name: IconName; size?: number }) {
  return (
    <svg class="icon" width={size} height={size} viewBox="0 0 20 20" aria-hidden="true" focusable="false">
      <path d={PATHS[name]} />
    </svg>
  );
}

export function Logo() {
  return (
    <svg class="logo" width="28" height="28" viewBox="0 0 32 32" aria-hidden="true" focusable="false">
      <path class="body" d="M16 2.5 28 9.2v13.6L16 29.5 4 22.8V9.2z" />
      <path class="seam" d="M16 16 4.6 9.5M16 16l11.4-6.5M16 16v13" />
      <path class="stitch" d="M16 3.4 10.2 12.7M16 3.4l5.8 9.3" />
    </svg>
  );
}
