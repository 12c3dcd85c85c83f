// Strokes of walls: the same as in twc_env/exploration/drawing/smooth_map.py, which explains them and sets the numbers W.
// kind: 0 unknown, 1 free, 2 wall, of each cell. Returns x1, y1, x2, y2 and half width [cells] of each stroke.
function wallStrokes(kind, [rows, columns], W) {
  const is_wall = (r, c) => r >= 0 && c >= 0 && r < rows && c < columns && kind[r * columns + c] === 2;
  const cells = [], lines = new Map(), strokes = [];
  for (let r = 0; r < rows; r++) for (let c = 0; c < columns; c++) if (is_wall(r, c)) cells.push([r, c]);
  const at = (r, c) => lines.get(r * columns + c), none = l => l.u === 0 && l.v === 0;
  function around(r, c, reach, visit) {
    const [low, high] = [Math.max(0, c - reach), Math.min(columns - 1, c + reach)];
    for (let m = Math.max(0, r - reach); m <= Math.min(rows - 1, r + reach); m++)
      for (let n = low; n <= high; n++) if (kind[m * columns + n] === 2) visit(m, n);
  }
  function lineAt(r, c, [spread, reach], on) {
    let k = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
    around(r, c, reach, (m, n) => {
      const x = n - c, y = m - r;
      if (on && Math.abs(on.u * y - on.v * x - on.shift) > W.across_max) return;
      const w = Math.exp(-0.5 * (x * x + y * y) / (spread * spread));
      k += w; sx += w * x; sy += w * y; sxx += w * x * x; sxy += w * x * y; syy += w * y * y;
    });
    const x = sx / k, y = sy / k, a = sxx / k - x * x, b = sxy / k - x * y, d = syy / k - y * y;
    const middle = (a + d) / 2, half = Math.hypot((a - d) / 2, b), across = Math.max(middle - half, 0);
    const angle = 0.5 * Math.atan2(2 * b, a - d), u = Math.cos(angle), v = Math.sin(angle), shift = u * y - v * x;
    const is_line = middle + half > 1e-9 && across <= W.line_max * (middle + half) && Math.abs(shift) <= W.shift_max;
    return is_line ? { u, v, shift, across } : null;
  }
  for (const [r, c] of cells) {
    let line = null;
    for (const view of W.windows) if ((line = lineAt(r, c, view, null))) break;
    for (let k = 0, next = line; k < 2 && next; k++) if ((next = lineAt(r, c, W.along, line))) line = next;
    const half = line ? Math.min(Math.max(Math.sqrt(3 * line.across), W.least), W.largest) : W.least;
    const { u, v, shift } = line || { u: 0, v: 0, shift: 0 };
    lines.set(r * columns + c, { x: c + 0.5 - v * shift, y: r + 0.5 + u * shift, u, v, half, even: half });
  }
  for (const [r, c] of cells) {
    const l = at(r, c);
    if (l.half > W.least) around(r, c, W.even_reach, (m, n) => {
      const o = at(m, n), aside = Math.abs(l.u * (o.y - l.y) - l.v * (o.x - l.x)), turn = Math.abs(l.u * o.v - l.v * o.u);
      if (!none(o) && turn <= W.aside_max && aside <= W.aside_max * W.even_reach) l.even = Math.min(l.even, o.half);
    });
  }
  function beyondGap(r, c, l, way) {
    let best = null, nearest = W.gap_max, goes_on = none(l);
    if (!goes_on) around(r, c, Math.floor(W.gap_max) + 1, (m, n) => {
      const o = at(m, n), x = o.x - l.x, y = o.y - l.y, away = Math.hypot(x, y), far = Math.max(Math.abs(m - r), Math.abs(n - c));
      if (far === 1 && way * (l.u * (n - c) + l.v * (m - r)) > 0.5) goes_on = true;
      if (far < 2 || away > nearest || way * (l.u * x + l.v * y) <= 0 || none(o)) return;
      if (Math.max(Math.abs(l.u * y - l.v * x), Math.abs(o.u * y - o.v * x)) > W.aside_max * away) return;
      best = o; nearest = away;
    });
    if (goes_on || !best || nearest <= W.gap_free_max) return goes_on ? null : best;
    let free = 0, count = 2 * Math.floor(W.gap_max);
    for (let k = 0; k < count; k++) {
      const t = (k + 0.5) / count, m = Math.floor(l.y + t * (best.y - l.y)), n = Math.floor(l.x + t * (best.x - l.x));
      free += kind[m * columns + n] === 1;
    }
    return free > 0.5 * count ? null : best;
  }
  for (const [r, c] of cells) {
    const l = at(r, c), [size, half] = W.square;
    const join = o => strokes.push([l.x, l.y, o.x, o.y, 0.5 * (l.even + o.even)]);
    let is_single = true;
    around(r, c, 1, (m, n) => { if (m !== r || n !== c) is_single = false; if (m > r || (m === r && n > c)) join(at(m, n)); });
    for (const way of [-1, 1]) { const o = beyondGap(r, c, l, way); if (o) { is_single = false; join(o); } }
    for (const aside of is_single ? [-size, size] : [])
      strokes.push([c + 0.5 - size, r + 0.5 + aside, c + 0.5 + size, r + 0.5 + aside, half]);
  }
  return strokes;
}
