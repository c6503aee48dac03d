// Points, image measurements, images, passes and profiles as tables. The server sorts and filters; the page asks for
// the rows that it shows. Many rows are marked to reject or accept them in one change, or to save them.

import {blobOf, download, make, short} from './plot.js';

const TABLES = {points: 'Points', measurements: 'Measurements', images: 'Images', passes: 'Passes', profiles: 'Profiles'};
const EMPTY = {passes: 'This block has no passes: each image has an orientation of its own.', profiles: 'This block has no laser profiles.'};
const ROW = 26, TALLEST = 8e6; // px of a row, and of what a browser scrolls
const BLOCK = 100, KEPT = 30, MOST = 200, WAIT = 250; // rows of a request, their blocks, rows of a change, ms

class Lists {
  constructor(app, element) {
    Object.assign(this, {app, element, name: 'points', states: new Map(), version: 0, computing: new Set(), chipsOf: ''});
    const button = (textContent, title, act) => {
      const one = make('button', {type: 'button', textContent, title});
      one.addEventListener('click', act);
      return one;
    };
    this.tabs = Object.entries(TABLES).map(([name, title]) => Object.assign(button(title, '', () => this.open(name)), {value: name}));
    this.rejected = make('input', {type: 'checkbox'});
    this.rejected.addEventListener('change', () => this.filter('rejected', this.rejected.checked));
    this.missing = make('span', {className: 'list-missing'});
    this.words = make('span', {className: 'caption', role: 'status'});
    this.acts = [['reject', 'Reject', 'r'], ['accept', 'Accept', 'a'], ['undecided', 'Undecided', 'u']].map(([kind, title, key]) =>
      Object.assign(button(`${title} (${key})`, '', () => this.act(kind)), {value: kind}));
    this.note = make('input', {type: 'text', size: 18, maxLength: 200, placeholder: 'note', title: 'Note about the row (n); Enter stores it'});
    this.note.addEventListener('keydown', event => { if (event.key === 'Enter') this.act(this.valueOf('verdict') || 'undecided', this.note.value); });
    this.reason = make('span', {className: 'caption'});
    this.all = button('Mark all', `Mark the rows that are listed, ${MOST} at the most`, () => this.markAll());
    this.none = button('Unmark', 'No row is marked any more', () => { this.state.marked.clear(); this.draw(); });
    this.save = button('Save table …', 'All rows that are listed, as CSV', () => this.saveTable());
    this.saveMarked = button('Save marked …', 'The marked rows, as CSV', () => this.saveRows());
    this.table = make('table', {}, this.head = make('thead'), this.body = make('tbody'));
    this.height = make('div', {className: 'list-all'}, this.table);
    this.grid = make('div', {className: 'list-scroll scroll', tabIndex: 0, role: 'grid'}, this.height);
    this.grid.setAttribute('aria-multiselectable', 'true');
    this.grid.addEventListener('scroll', () => this.draw());
    this.grid.addEventListener('keydown', event => this.key(event));
    this.body.addEventListener('click', event => this.click(event));
    this.body.addEventListener('dblclick', () => this.select(true));
    this.side = make('div', {className: 'list-side', hidden: true});
    new ResizeObserver(() => this.draw()).observe(this.grid);
    element.classList.add('lists');
    element.replaceChildren(
      make('div', {className: 'tools'}, ...this.tabs, this.only = make('label', {}, this.rejected, 'only rejected'), this.missing, this.words),
      make('div', {className: 'tools'}, ...this.acts, this.note, this.all, this.none, this.save, this.saveMarked, this.reason),
      make('div', {className: 'list-middle'}, this.grid, this.side));
    for (const event of ['opened', 'renewed', 'changed']) app.addEventListener(event, () => this.reload());
    app.addEventListener('selected', ({detail}) => { if (!this.selecting) this.reload(detail); });
    app.addEventListener('shown', ({detail}) => { if (detail === 'lists') { this.reload(app.selection); this.grid.focus({preventScroll: true}); } });
    this.open('points');
  }

  get state() {
    return this.states.get(this.name);
  }

  open(name) {
    this.name = name;
    if (!this.state) this.states.set(name, {sort: '', filters: {}, active: 0, marked: new Map(), blocks: new Map(), found: null, top: 0});
    for (const tab of this.tabs) tab.setAttribute('aria-pressed', String(tab.value === name));
    this.grid.setAttribute('aria-label', TABLES[name]);
    this.columns = '';
    this.reload(this.app.selection);
  }

  query(more = {}) {
    const {sort, filters} = this.state;
    return new URLSearchParams({table: this.name, ...(sort ? {sort} : {}), ...filters, ...more});
  }

  // Everything anew, with a point in sight where it is named
  async reload(find = '') {
    if (!this.app.scene || this.element.hidden) return;
    const version = ++this.version, {state} = this, late = setTimeout(() => { this.words.textContent = 'reading …'; }, 200);
    const first = BLOCK * Math.floor(this.first / BLOCK) || 0;
    try {
      const found = await this.app.request(`/api/list?${this.query({first, count: BLOCK, ...(find ? {find} : {})})}`);
      if (version !== this.version) return;
      Object.assign(state, {found, blocks: new Map([[first / BLOCK, found.rows]]), active: Math.max(0, Math.min(state.active, found.count - 1))});
      this.showHead();
      if (found.at !== null) this.go(found.at);
      this.draw();
      this.computeAll();
    } catch (error) {
      if (version === this.version) this.words.textContent = error.message;
    } finally {
      clearTimeout(late);
    }
  }

  async read(block) {
    const {blocks} = this.state, {version} = this;
    if (blocks.has(block)) return;
    blocks.set(block, null);
    const found = await this.app.request(`/api/list?${this.query({first: BLOCK * block, count: BLOCK})}`).catch(() => null);
    if (version !== this.version) return;
    if (found) blocks.set(block, found.rows);
    else blocks.delete(block);
    for (const old of [...blocks.keys()].slice(0, -KEPT)) blocks.delete(old);
    this.draw();
  }

  // Columns that take long: computed at once in a small block, at a click in a large one
  computeAll() {
    const {missing} = this.state.found;
    for (const {group, at_once: atOnce} of missing) if (atOnce) this.compute(group);
    this.missing.replaceChildren(...missing.map(({group, title}) => {
      const busy = this.computing.has(group);
      const one = make('button', {type: 'button', disabled: busy, textContent: busy ? `computing ${title} …` : `Compute ${title}`, title: 'In a large block this takes minutes; go on working meanwhile'});
      one.addEventListener('click', () => { this.compute(group); this.computeAll(); });
      return one;
    }));
  }

  async compute(group) {
    if (this.computing.has(group)) return;
    this.computing.add(group);
    try {
      await this.app.request(`/api/list/compute?group=${group}`);
    } catch (error) {
      this.app.say(error.message, 'error');
      return; // not asked for again by itself
    }
    this.computing.delete(group);
    this.reload();
  }

  showHead() {
    const {columns, missing} = this.state.found, {sort, filters} = this.state, keys = `${this.name} ${columns.map(one => one.key)}`;
    this.only.hidden = !columns.some(one => one.key === 'rejected' || one.key === 'state');
    if (keys !== this.columns) {
      const widths = columns.map((one, k) => (one.text ? Math.min(34, Math.max(9, one.title.length + 4, ...this.state.found.rows.map(row => row[k].length + 2))) : Math.max(9, one.title.length + 4)));
      const titles = columns.map(one => {
        const button = make('button', {type: 'button', title: `${one.meaning ? `${one.meaning}; ` : ''}sort`}, one.title, make('small', {textContent: one.unit}));
        button.addEventListener('click', () => this.sortBy(one));
        return make('th', {scope: 'col'}, button);
      });
      const conditions = columns.map(one => {
        const input = make('input', {type: 'text', placeholder: one.text ? 'contains' : '> 3', maxLength: 60, value: filters[one.key] || ''});
        input.setAttribute('aria-label', `Filter of ${one.title}`);
        input.addEventListener('input', () => { clearTimeout(this.typing); this.typing = setTimeout(() => this.filter(one.key, input.value), WAIT); });
        return make('th', {}, input);
      });
      this.head.replaceChildren(make('tr', {}, ...titles), make('tr', {className: 'list-filters'}, ...conditions));
      this.table.querySelector('colgroup')?.remove();
      this.table.prepend(make('colgroup', {}, ...widths.map(width => make('col', {style: `width:${width}ch`}))));
      this.table.style.width = `max(100%, ${widths.reduce((sum, one) => sum + one, 0)}ch)`;
      this.columns = keys;
    }
    columns.forEach((one, k) => this.head.rows[0].cells[k].setAttribute('aria-sort', {[one.key]: 'ascending', [`-${one.key}`]: 'descending'}[sort] || 'none'));
    return missing;
  }

  // Numbers: the largest first, then the smallest; texts the other way round
  sortBy({key, text}) {
    const turns = text ? [key, `-${key}`, ''] : [`-${key}`, key, ''], {state} = this;
    state.sort = turns[(turns.indexOf(state.sort) + 1) % 3];
    this.top();
  }

  filter(key, value) {
    const {filters} = this.state;
    if (key === 'rejected' && typeof value === 'boolean') {
      const column = this.state.found.columns.some(one => one.key === 'state') ? ['state', 'rejected'] : ['rejected', '> 0'];
      [key, value] = [column[0], value ? column[1] : ''];
      this.head.rows[1].cells[this.state.found.columns.findIndex(one => one.key === key)].firstChild.value = value;
    }
    if (value.trim()) filters[key] = value.trim();
    else delete filters[key];
    this.top();
  }

  top() {
    this.state.active = 0;
    this.grid.scrollTop = 0;
    this.reload();
  }

  // --- rows

  get shown() {
    return Math.max(1, Math.floor((this.grid.clientHeight - this.head.offsetHeight) / ROW));
  }

  get hidden() {
    return Math.max(0, (this.state.found?.count || 0) - this.shown); // rows beyond one window
  }

  get first() {
    const far = Math.min(ROW * this.hidden, TALLEST);
    return far ? Math.min(this.hidden, Math.round(this.grid.scrollTop / far * this.hidden)) : 0;
  }

  row(number) {
    return this.state.blocks.get(Math.floor(number / BLOCK))?.[number % BLOCK];
  }

  draw() {
    const {state} = this, {found} = state;
    if (!found || !this.grid.clientHeight) return;
    this.height.style.height = `${this.grid.clientHeight + Math.min(ROW * this.hidden, TALLEST)}px`;
    const {first, shown} = this, last = Math.min(found.count, first + shown);
    for (let block = Math.floor(first / BLOCK); BLOCK * block < last; block++) this.read(block);
    this.body.replaceChildren(...Array.from({length: Math.max(0, last - first)}, (_, k) => this.drawn(first + k)));
    this.grid.setAttribute('aria-rowcount', String(found.count));
    this.grid.setAttribute('aria-activedescendant', `list-row-${state.active}`);
    const filtered = found.count === found.total ? '' : ` of ${found.total.toLocaleString('en')}`;
    this.words.textContent = found.total ? `${found.count.toLocaleString('en')}${filtered} rows${state.marked.size ? `, ${state.marked.size} marked` : ''}` : EMPTY[this.name] || 'none';
    this.showActs();
    this.showChips();
  }

  drawn(number) {
    const row = this.row(number), {found, active, marked} = this.state;
    const line = make('tr', {id: `list-row-${number}`, className: number === active ? 'active' : ''});
    line.dataset.row = number;
    line.setAttribute('aria-rowindex', String(number + 1));
    line.setAttribute('aria-selected', String(Boolean(row) && marked.has(this.keyOf(row))));
    if (row && row[0] === this.app.selection) line.setAttribute('aria-current', 'true');
    line.append(...found.columns.map(({key, text}, k) => {
      const value = row?.[k] ?? '', near = ['line', 'sample'].includes(key);
      return make('td', {className: text ? '' : 'number', textContent: text || value === '' ? value : near ? value.toFixed(2) : short(value, 4), title: text ? value : ''});
    }));
    return line;
  }

  keyOf(row) {
    return this.name === 'measurements' ? `${row[0]}\n${row[1]}` : row[0];
  }

  valueOf(key) {
    return this.row(this.state.active)?.[this.state.found?.columns.findIndex(one => one.key === key)] || '';
  }

  // The active row, brought into sight
  go(number) {
    const {state} = this, {first, shown} = this;
    state.active = Math.max(0, Math.min(number, state.found.count - 1));
    const to = state.active < first ? state.active : state.active >= first + shown ? state.active - shown + 1 : first;
    if (to !== first) {
      this.height.style.height = `${this.grid.clientHeight + Math.min(ROW * this.hidden, TALLEST)}px`;
      this.grid.scrollTop = to / this.hidden * Math.min(ROW * this.hidden, TALLEST);
    }
    this.draw();
  }

  mark(number) {
    const row = this.row(number), {marked, found} = this.state;
    if (row && !marked.delete(this.keyOf(row))) marked.set(this.keyOf(row), Object.fromEntries(found.columns.map((one, k) => [one.key, row[k]])));
  }

  async markAll() {
    const {rows, columns} = await this.app.request(`/api/list?${this.query({first: 0, count: MOST})}`);
    for (const row of rows) this.state.marked.set(this.keyOf(row), Object.fromEntries(columns.map((one, k) => [one.key, row[k]])));
    this.draw();
  }

  select(whole = false) {
    const row = this.row(this.state.active);
    if (!row) return;
    this.selecting = true;
    if (['points', 'measurements'].includes(this.name)) this.app.select(row[0]);
    this.selecting = false;
    if (this.name === 'images') (whole ? this.app.show('images') : Promise.resolve()).then(() => this.app.emit('image', row[0]));
    this.draw();
  }

  click(event) {
    const number = Number(event.target.closest('tr')?.dataset.row ?? -1);
    if (number < 0) return;
    if (event.shiftKey) for (let k = Math.min(number, this.state.active); k <= Math.max(number, this.state.active); k++) this.mark(k);
    else if (event.ctrlKey || event.metaKey) this.mark(number);
    this.go(number);
    this.select();
  }

  key(event) {
    if (event.target !== this.grid || event.ctrlKey || event.metaKey || event.altKey) return;
    const {active, found} = this.state, acts = {r: 'reject', a: 'accept', ...(this.app.scene.verdicts ? {u: 'undecided'} : {})};
    const to = {ArrowDown: active + 1, ArrowUp: active - 1, PageDown: active + this.shown, PageUp: active - this.shown, Home: 0, End: (found?.count || 1) - 1}[event.key];
    if (to !== undefined) this.go(to);
    else if (event.key === 'Enter') this.select(true);
    else if (event.key === ' ') { this.mark(active); this.go(active + 1); } else if (acts[event.key]) this.act(acts[event.key]);
    else if (event.key === 'n' && !this.note.hidden) this.note.focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  // --- reject and accept, save

  // Why rows can't be rejected or accepted; empty where they can
  get refusal() {
    const {scene} = this.app, {size} = this.state.marked;
    if (scene.kind !== 'project' && !scene.verdicts) return 'Rejecting needs a project: mgsgraph project init PROJECT --case CASE; verdicts need --case CASE.';
    if (scene.kind !== 'project' && this.name !== 'points') return 'Verdicts are about tie points, in the list of points; measurements are rejected in a project: mgsgraph project init PROJECT --case CASE.';
    if (!['points', 'measurements'].includes(this.name)) return 'Points and measurements can be rejected.';
    if (scene.kind === 'project' && !scene.writable) return scene.lock;
    return size > MOST ? `At most ${MOST} rows at a time: ${size} are marked.` : '';
  }

  showActs() {
    const {refusal} = this, {scene} = this.app;
    for (const one of this.acts) Object.assign(one, {disabled: Boolean(refusal), title: refusal || 'The marked rows, or the active row'});
    this.acts[2].hidden = this.note.hidden = !scene.verdicts;
    this.note.disabled = Boolean(refusal);
    if (document.activeElement !== this.note) this.note.value = this.valueOf('note');
    this.reason.textContent = refusal || (scene.verdicts ? `Verdicts are in ${scene.verdicts.split(/[\\/]/).pop()}.` : '');
    this.reason.title = refusal || scene.verdicts || '';
    const {count} = this.state.found, many = count > MOST;
    Object.assign(this.all, {disabled: many || !count, title: many ? `More than ${MOST} rows: filter first` : 'Mark the rows that are listed'});
    this.none.disabled = this.saveMarked.disabled = !this.state.marked.size;
  }

  async act(kind, note) {
    const {state} = this, {scene} = this.app, rows = [...state.marked.values()];
    if (this.refusal) return this.app.say(this.refusal, 'error');
    if (!rows.length) {
      const row = this.row(state.active);
      if (!row) return undefined;
      rows.push(Object.fromEntries(state.found.columns.map((one, k) => [one.key, row[k]])));
    }
    this.app.say(`${rows.length} rows: ${kind} …`);
    try {
      if (scene.kind === 'project') await this.app.change({kind, rows: rows.map(one => [one.id ?? one.point, one.image ?? ''])});
      else {
        await this.app.request('/api/verdicts', {verdict: kind, points: rows.map(one => one.id), ...(note === undefined ? {} : {note})});
        this.app.say(`${rows.length === 1 ? rows[0].id : `${rows.length} points`}: ${kind}.`);
      }
      if (!state.marked.size && scene.kind !== 'project') this.state.active += 1;
      state.marked.clear();
      await this.reload();
      this.go(state.active);
    } catch (error) {
      this.app.say(error.message, 'error');
    }
    return this.grid.focus({preventScroll: true});
  }

  saveTable() {
    return download(`/api/list/csv?${this.query()}`, `${this.name}.csv`).catch(error => this.app.say(error.message, 'error'));
  }

  saveRows() {
    const {columns} = this.state.found, quoted = value => (/[",\r\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
    const rows = [columns.map(one => (one.unit ? `${one.key}_${one.unit}` : one.key)), ...[...this.state.marked.values()].map(row => columns.map(one => String(row[one.key] ?? '')))];
    const href = URL.createObjectURL(new Blob([rows.map(row => `${row.map(quoted).join(',')}\n`).join('')], {type: 'text/csv'}));
    make('a', {href, download: `${this.name}_marked.csv`}).click();
    setTimeout(() => URL.revokeObjectURL(href), 60000);
  }

  // --- the pixels of the active row's point

  showChips() {
    const row = this.row(this.state.active), pictured = new Set(this.app.scene.images.filter(one => one.picture).map(one => one.name));
    const point = row && pictured.size && ['points', 'measurements'].includes(this.name) ? row[0] : '';
    if (this.side.hidden === Boolean(point)) {
      this.side.hidden = !point;
      return this.draw();
    }
    if (!point || point === this.chipsOf) return undefined;
    this.chipsOf = point;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.chips(point, pictured).catch(error => this.app.say(error.message, 'error')), 80);
    return undefined;
  }

  async chips(point, pictured) {
    const {columns, rows} = await this.app.request(`/api/list?${new URLSearchParams({table: 'measurements', point: `=${point}`, count: 12})}`);
    if (point !== this.chipsOf) return;
    const at = key => columns.findIndex(one => one.key === key);
    this.side.replaceChildren(make('strong', {textContent: point}), ...rows.map(row => {
      const [image, line, sample, state, residual] = ['image', 'line', 'sample', 'state', 'residual_sigmas'].map(key => row[at(key)]);
      const picture = make('img', {width: 130, height: 130, alt: `Pixels of ${image} around the measurement`}), chip = make('div', {className: 'chip'}, picture);
      if (pictured.has(image)) blobOf(`/api/chip.png?${new URLSearchParams({image, line, sample})}`).then(src => Object.assign(picture, {src, onload: () => URL.revokeObjectURL(src)}), () => chip.remove());
      return make('figure', {}, pictured.has(image) ? chip : '', make('figcaption', {textContent: `${image}, ${state}${residual ? `, residual ${short(residual)} sigmas` : ''}`}));
    }), ...(rows.length ? [] : [make('p', {className: 'caption', textContent: 'No image measurement.'})]));
  }
}

export function panel(app, element) {
  element.view = new Lists(app, element);
  return element.view;
}
