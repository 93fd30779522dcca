// Makes figures zoom: beside its static picture, which stays for paper, each holds as JSON what it shows (zoom.py).
const numbers = text => {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return Array.from(new Float32Array(bytes.buffer), v => Number.isNaN(v) ? null : v);
};
const short = v => v == null ? "" : v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e5) ? v.toExponential(2).replace(/\.?0+e/, "e") : String(+v.toPrecision(4));
const make = (tag, parent, name, text) => {
  const made = parent.appendChild(document.createElement(tag));
  made.className = name;
  if (text) made.textContent = text;
  return made;
};

// uPlot's own ticks of a logarithmic axis never end where it begins just below a decade
const decades = (u, axis, min, max) => {
  const first = Math.floor(Math.log10(min)), last = Math.ceil(Math.log10(max)), out = [];
  const room = (axis ? u.height / 18 : u.width / 60), step = Math.max(1, Math.ceil((last - first) / room));
  for (let e = first; e <= last; e += step) for (const m of (last - first) * 3 <= room ? [1, 2, 5] : [1]) out.push(+`${m}e${e}`);
  const inside = out.filter(v => v >= min && v <= max);
  return inside.length ? inside : [min, max];
};
const ticked = (log, given) => given ? { splits: () => given } : log ? { splits: decades, filter: (_, splits) => splits } : {};

// what lies under the lines: shaded spans of x, levels of y, bands
function ground(u, axes) {
  const { ctx, bbox } = u, ratio = uPlot.pxRatio;
  const x = v => u.valToPos(v, "x", true), y = v => u.valToPos(v, "y", true);
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  for (const s of axes.spans) {
    ctx.globalAlpha = s.alpha;
    ctx.fillStyle = s.colour;
    if (s.from != null) ctx.fillRect(x(s.from), bbox.top, Math.max(x(s.to) - x(s.from), ratio), bbox.height);
    else ctx.fillRect(bbox.left, y(s.top), bbox.width, Math.max(y(s.bottom) - y(s.top), ratio));
  }
  for (const b of axes.bands) {
    ctx.globalAlpha = b.alpha;
    ctx.fillStyle = b.colour;
    ctx.beginPath();
    b.x.forEach((v, i) => ctx.lineTo(x(v), y(b.high[i])));
    for (let i = b.x.length - 1; i >= 0; i--) ctx.lineTo(x(b.x[i]), y(b.low[i]));
    ctx.fill();
  }
  ctx.globalAlpha = 1;
  for (const l of axes.levels) {
    ctx.strokeStyle = l.colour;
    ctx.lineWidth = l.width * ratio;
    ctx.setLineDash(l.dash.map(d => d * ratio));
    ctx.beginPath();
    ctx.moveTo(bbox.left, y(l.y));
    ctx.lineTo(bbox.left + bbox.width, y(l.y));
    ctx.stroke();
  }
  ctx.restore();
}

function draw(figure) {
  const key = `figure ${Math.random()}`, said = JSON.parse(figure.querySelector("script").textContent), image = figure.querySelector("img");
  const box = document.createElement("div"), plots = [];
  box.className = "plots";
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", image.alt);
  figure.insertBefore(box, image);
  const head = make("p", box, "legend"), values = new Map();
  for (const l of said.legend) {
    const item = make("span", head, "");
    const mark = make("i", item, "");
    mark.style.borderTop = `${l.band ? 8 : 3}px ${l.dash.length ? "dashed" : l.line ? "solid" : "dotted"} ${l.colour}`;
    mark.style.opacity = l.alpha;
    item.append(l.label);
    values.set(l.label, make("b", item, ""));
  }
  let under = null;
  const at = make("span", head, "at");
  const idle = "drag: zoom; double click: all";
  at.textContent = idle;
  if (said.ylabel) make("p", box, "label", said.ylabel);
  const grid = make("div", box, "grid");
  const all = (u, axes) => u.batch(() => {
    u.setScale("x", { min: axes.xlim[0], max: axes.xlim[1] });
    u.setScale("y", { min: axes.ylim[0], max: axes.ylim[1] });
  });
  const space = said.columns > 1 ? 44 : 52;
  grid.style.gridTemplateColumns = `calc((100% - ${space}px) / ${said.columns} + ${space}px) repeat(${said.columns - 1}, minmax(0, 1fr))`;
  if (said.columns === 1) grid.style.gridTemplateColumns = "minmax(0, 1fr)";
  for (const axes of said.axes) {
    const cell = make("div", grid, "cell");
    cell.style.gridArea = `${axes.row + 1} / ${axes.column + 1}`;
    if (axes.title) make("p", cell, "label", axes.title);
    const place = make("div", cell, "");
    if (axes.xlabel) make("p", cell, "label below", axes.xlabel);
    for (const s of axes.series) { s.x = numbers(s.x); s.y = numbers(s.y); }
    for (const b of axes.bands) { b.x = numbers(b.x); b.low = numbers(b.low); b.high = numbers(b.high); }
    const line = s => ({
      label: s.label, stroke: s.colour, width: s.width, dash: s.dash, ...(!s.line ? { paths: () => null } : s.steps ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}),
      points: { show: s.marks > 0, size: s.marks, fill: s.colour, width: 0 }
    });
    const ticks = { stroke: "#5a6068", font: "11px system-ui, sans-serif", grid: { stroke: "#e6e6e6", width: 1 }, ticks: { size: 4, stroke: "#cccccc" } };
    const height = () => Math.max(90, Math.round(figure.clientWidth * axes.height));
    const u = new uPlot({
      width: Math.max(place.clientWidth, 60), height: height(), legend: { show: false }, padding: [6, 12, 0, 0],
      scales: {
        x: { time: false, auto: false, min: axes.xlim[0], max: axes.xlim[1], distr: axes.xlog ? 3 : 1 },
        y: { auto: false, min: axes.ylim[0], max: axes.ylim[1], distr: axes.ylog ? 3 : 1 }
      },
      series: [{}, ...axes.series.map(line)],
      axes: [
        { ...ticks, size: 24, space: 50, values: (_, splits) => splits.map(short), ...ticked(axes.xlog, axes.xticks) },
        { ...ticks, size: axes.column ? 4 : space, space: (_u, _axis, _low, _high, size) => Math.min(22, Math.max(12, size / 4)), values: (_, splits) => splits.map(v => axes.column ? "" : short(v)), ...ticked(axes.ylog, axes.yticks) }
      ],
      cursor: {
        drag: { x: true, y: true, uni: 30, setScale: false },
        points: { show: false },
        sync: { key, filters: { pub: kind => kind === "mousemove" || kind === "mouseleave" } },
        bind: { dblclick: () => () => plots.forEach(p => all(p.u, p.axes)) }
      },
      hooks: {
        drawAxes: [u => ground(u, axes)],
        setSelect: [u => {
          const { left, top, width, height } = u.select, wide = width > 0 && width < u.over.clientWidth;
          const x = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
          if (wide) for (const p of said.sharex ? plots : [{ u }]) p.u.setScale("x", { min: x[0], max: x[1] });
          if (height > 0 && height < u.over.clientHeight) u.setScale("y", { min: u.posToVal(top + height, "y"), max: u.posToVal(top, "y") });
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [u => {
          if (u.over.matches(":hover")) under = u; // the others' cursors follow
          else if (under !== u) return;
          const { left } = u.cursor;
          at.textContent = left < 0 ? idle : short(u.posToVal(left, "x"));
          values.forEach(v => { v.textContent = ""; });
          if (left >= 0) for (const s of axes.series) {
            const where = u.posToVal(left, "x");
            if (!values.has(s.label) || where < s.x[0] || where > s.x.at(-1)) continue;
            let low = 0, high = s.x.length - 1;
            while (high - low > 1) { const mid = (low + high) >> 1; if (s.x[mid] > where) high = mid; else low = mid; }
            values.get(s.label).textContent = " " + short(s.y[where - s.x[low] < s.x[high] - where ? low : high]);
          }
        }]
      }
    }, axes.series.length ? uPlot.join(axes.series.map(s => [s.x, s.y])) : [axes.xlim], place);
    plots.push({ u, axes });
    new ResizeObserver(() => {
      const size = { width: place.clientWidth, height: height() };
      if (size.width > 60 && (size.width !== u.width || size.height !== u.height)) u.setSize(size);
    }).observe(place);
  }
  if (said.xlabel) make("p", box, "label below", said.xlabel);
  figure.classList.add("drawn");
}

addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(d => { d.open = true; }));
for (const figure of document.querySelectorAll("figure.zoom:not(.drawn)")) draw(figure);
