/* Charts: a thin layer over Chart.js, with the colours of the style sheet, and only as much as is on the screen. */

export function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return {
    text: of("text"),
    muted: of("muted"),
    grid: of("grid"),
    surface: of("surface"),
    axes: [of("axis-1"), of("axis-2"), of("axis-3")],
    band: [of("band-1"), of("band-2"), of("band-3")],
    board: of("board"),
    under: of("board-under"),
    edge: of("board-edge"),
    outline: of("board-outline"),
    chip: of("board-chip"),
    pad: of("board-pad"),
    arm: of("arm"),
    accent: of("accent"),
  };
}

/** Calls f when light becomes dark or dark light; returns what ends that. */
export function on_scheme(f) {
  const query = matchMedia("(prefers-color-scheme: dark)");
  query.addEventListener("change", f);
  return () => query.removeEventListener("change", f);
}

/** A chart of lines on numeric axes. lines: [{label, colour: 0 to 2, dash, fill, hidden}], where `fill` makes a band
 * between this line and the one before it. x, y: {title, min, max, type}. */
export class Plot {
  constructor(canvas, {lines, x, y, legend = true}) {
    this.lines = lines;
    this.chart = new window.Chart(canvas, {
      type: "line",
      data: {
        datasets: lines.map((line) => ({
          label: line.label,
          data: [],
          borderDash: line.dash ? [4, 3] : [],
          pointRadius: 0,
          borderWidth: line.fill !== undefined || line.bare ? 0 : line.dash ? 1.25 : 1.75,
          fill: line.fill,
          hidden: line.hidden ?? false,
        })),
      },
      options: {
        animation: false,
        parsing: false,
        normalized: true,
        responsive: true,
        maintainAspectRatio: false,
        events: [],
        spanGaps: false,
        plugins: {
          legend: {
            display: legend,
            align: "end",
            labels: {
              boxWidth: 14,
              boxHeight: 1.5,
              padding: 8,
              font: {size: 11},
              filter: (item, {datasets}) => {
                const line = lines[item.datasetIndex];
                return (
                  !line.bare && line.fill === undefined && (!line.dash || datasets[item.datasetIndex].data.length > 0)
                );
              },
            },
          },
          tooltip: {enabled: false},
        },
        scales: {x: this.axis(x), y: this.axis(y)},
      },
    });
    this.visible = true;
    this.observer = new IntersectionObserver(([entry]) => (this.visible = entry.isIntersecting));
    this.observer.observe(canvas);
    this.paint();
  }

  axis({title, ticks, ...rest}) {
    return {
      type: "linear",
      title: {display: Boolean(title), text: title, font: {size: 11}},
      ticks: {maxTicksLimit: 6, includeBounds: false, font: {size: 11}, maxRotation: 0, ...ticks},
      ...rest,
      border: {display: false},
    };
  }

  paint() {
    const c = colours();
    this.chart.data.datasets.forEach((set, i) => {
      const line = this.lines[i];
      set.borderColor = c.axes[line.colour];
      set.backgroundColor = line.fill === undefined ? c.axes[line.colour] : c.band[line.colour];
    });
    for (const axis of Object.values(this.chart.options.scales)) {
      axis.grid = {color: c.grid, drawBorder: false, tickLength: 4};
      axis.ticks.color = c.muted;
      axis.title.color = c.muted;
    }
    this.chart.options.plugins.legend.labels.color = c.text;
    this.chart.update("none");
  }

  /** data: an array of points for each line. */
  show(data, limits) {
    if (!this.visible) return;
    this.chart.data.datasets.forEach((set, i) => (set.data = data[i] ?? []));
    for (const [axis, range] of Object.entries(limits ?? {})) Object.assign(this.chart.options.scales[axis], range);
    this.chart.update("none");
  }

  /** Width over height of the drawing area. */
  aspect() {
    const area = this.chart.chartArea;
    return area ? (area.right - area.left) / (area.bottom - area.top) : 1;
  }

  close() {
    this.observer.disconnect();
    this.chart.destroy();
  }
}
