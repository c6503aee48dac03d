// Points, image measurements, images, passes and profiles as tables. The server sorts and filters; the page asks for
// the rows that it shows. Many rows are marked to reject or accept them in one change, or to save them.

import {withModifier} from './app.js';
import {Chips} from './chips.js';
import {button, caption, check, download, make, save, short} from './plot.js';

const TABLES = {points: 'Points', measurements: 'Measurements', images: 'Images', passes: 'Passes', profiles: 'Profiles'};
const FIRST = {points: '-residual_sigmas', measurements: '-residual_sigmas', images: '-rms', profiles: '-shift_sigmas'}; // orders to begin with
const EMPTY = {passes: 'no passes: each image has an orientation of its own', profiles: 'no laser profiles'};
const ACTS = {r: ['reject', 'Reject'], a: ['accept', 'Accept'], u: ['undecided', 'Undecided']}; // by their keys
const ROW = 26, TALLEST = 8e6; // px of a row, and of what a browser scrolls
const BLOCK = 100, KEPT = 30, MOST = 200, WAIT = 250; // rows of a request, their blocks, rows of a change, ms

class Lists {
  constructor(app, element) {
    Object.assign(this, {app, element, states: {}, version: 0, computing: new Set(), failed: new Set(), point: '', pending: 0});
    this.tabs = Object.entries(TABLES).map(([value, title]) => Object.assign(button(title, () => { this.open(value); this.reload(app.selection); }), {value}));
    this.only = check('only rejected', false, on => this.renew({only: on ? 'rejected' : ''}));
    this.missing = make('span');
    this.words = make('span', {className: 'caption', role: 'status'});
    this.acts = Object.entries(ACTS).map(([key, [value, title]]) => Object.assign(button(`${title} (${key})`, () => this.act(value)), {value}));
    const about = 'Note about the active row; Enter stores it';
    this.note = make('input', {type: 'text', size: 18, maxLength: 200, placeholder: 'note (n)', title: about, ariaLabel: about});
    this.note.addEventListener('keydown', event => { if (event.key === 'Enter') this.act(this.cell('verdict') || 'undecided', this.note.value); });
    this.reason = make('span', {className: 'caption'});
    this.all = button('Mark all', () => this.markAll());
    this.none = button('Unmark', () => { this.state.marked.clear(); this.draw(); }, {title: 'No row is marked any more'});
    this.save = button('', () => (this.state.marked.size ? this.saveMarked() : app.orSay(download(`/api/list/csv?${this.query()}`, `${this.name}.csv`))));
    this.table = make('table', {}, this.widths = make('colgroup'), this.head = make('thead'), this.body = make('tbody'));
    this.whole = make('div', {className: 'list-all'}, this.table);
    this.grid = make('div', {className: 'list-scroll scroll', tabIndex: 0, role: 'grid', ariaMultiSelectable: 'true'}, this.whole);
    this.grid.addEventListener('scroll', () => this.draw());
    this.grid.addEventListener('keydown', event => this.key(event));
    this.body.addEventListener('click', event => this.click(event));
    this.body.addEventListener('dblclick', () => this.select(true));
    this.side = make('div', {className: 'list-side', hidden: true});
    new ResizeObserver(() => this.draw()).observe(this.grid);
    element.classList.add('lists');
    element.replaceChildren(
      make('div', {className: 'tools'}, ...this.tabs, this.only, this.missing, this.words),
      make('div', {className: 'tools'}, ...this.acts, this.note, this.all, this.none, this.save, this.reason),
      make('div', {className: 'list-middle'}, this.grid, this.side));
    app.addEventListener('renewed', () => this.reload());
    app.addEventListener('selected', ({detail}) => { if (!this.selecting) this.reload(detail); });
    app.addEventListener('shown', ({detail}) => { if (detail === 'lists') this.reload(app.selection).then(() => this.grid.focus({preventScroll: true})); });
    this.open('points');
  }

  open(name) {
    this.name = name;
    this.state = this.states[name] ??= {sort: FIRST[name] || '', only: '', filters: {}, active: 0, marked: new Map(), blocks: new Map(), found: null};
    for (const tab of this.tabs) tab.ariaPressed = String(tab.value === name);
    this.grid.ariaLabel = TABLES[name];
    this.only.control.checked = Boolean(this.state.only);
  }

  get ofPoints() { return this.name === 'points' || this.name === 'measurements'; }

  query(more = {}) {
    const {sort, only, filters} = this.state;
    return new URLSearchParams({table: this.name, sort, only, ...filters, ...more});
  }

  // Another order or filter, from its first row on
  renew(changes) {
    Object.assign(this.state, changes, {active: 0});
    this.grid.scrollTop = 0;
    return this.reload();
  }

  // All rows anew, with a point in sight where it is named
  async reload(find = '') {
    if (this.element.hidden) return;
    const version = ++this.version, {state} = this, {active} = state, block = Math.floor(this.first / BLOCK);
    try {
      const found = await this.app.request(`/api/list?${this.query({first: BLOCK * block, count: BLOCK, find})}`);
      if (version !== this.version || this.pending) return;
      Object.assign(state, {found, blocks: new Map([[block, found.rows]])});
      this.showHead();
      this.go(state.active === active ? found.at ?? active : state.active); // keys may have gone on meanwhile
      this.showMissing();
    } catch (error) {
      if (version !== this.version) return;
      Object.assign(state, {found: state.found && {...state.found, count: 0}, blocks: new Map()}); // no rows of another filter
      this.draw();
      this.words.textContent = error.message;
    }
  }

  async read(block) {
    const {blocks} = this.state, {version} = this;
    if (blocks.has(block)) return;
    blocks.set(block, null);
    const found = await this.app.request(`/api/list?${this.query({first: BLOCK * block, count: BLOCK})}`).catch(() => null);
    if (version !== this.version) return;
    blocks.set(block, found?.rows);
    for (const old of [...blocks.keys()].slice(0, -KEPT)) blocks.delete(old);
    if (found) this.draw();
  }

  // Columns that take long: computed at once in a small block, at a click in a large one
  showMissing() {
    const {missing} = this.state.found;
    for (const one of missing) if (one.at_once && !this.failed.has(one.group)) this.compute(one.group);
    this.missing.replaceChildren(...missing.map(({group, title}) => button(
      this.computing.has(group) ? `computing ${title} …` : `Compute ${title}`, () => { this.compute(group); this.showMissing(); },
      {title: 'In a large block this takes minutes; go on working meanwhile', disabled: this.computing.has(group)})));
  }

  async compute(group) {
    if (this.computing.has(group)) return;
    this.computing.add(group);
    await this.app.request(`/api/list/compute?group=${group}`).catch(error => { this.failed.add(group); this.app.say(error.message, 'error'); });
    this.computing.delete(group);
    this.reload();
  }

  showHead() {
    const {found: {columns, rows}, sort, filters} = this.state, keys = `${this.name} ${columns.map(one => one.key)}`;
    if (keys !== this.keys) {
      const longest = k => Math.max(...rows.map(row => Math.min(34, row[k].length + 2)));
      const width = (one, k) => Math.max(7, ...`${one.title} ${one.unit}`.split(' ').map(word => word.length + 3), one.decimals === null ? longest(k) : 0);
      this.widths.replaceChildren(...columns.map((one, k) => make('col', {style: `width: ${width(one, k)}ch`})));
      this.whole.style.minWidth = `${columns.reduce((sum, one, k) => sum + width(one, k), 0)}ch`;
      this.head.replaceChildren(make('tr'), make('tr', {className: 'list-filters'}));
      for (const one of columns) {
        const input = make('input', {type: 'text', placeholder: one.decimals === null ? 'text' : '> 3', maxLength: 60, value: filters[one.key] || ''});
        input.ariaLabel = `Filter of ${one.title}`;
        input.addEventListener('input', () => {
          filters[one.key] = input.value.trim();
          clearTimeout(this.typing);
          this.typing = setTimeout(() => this.renew({}), WAIT);
        });
        const title = button(one.title, () => this.sortBy(one), {title: `${one.meaning ? `${one.meaning}; ` : ''}click to sort`});
        title.append(make('small', {textContent: one.unit}));
        this.head.rows[0].append(make('th', {scope: 'col', className: one.decimals === null ? '' : 'number'}, title));
        this.head.rows[1].append(make('th', {}, input));
      }
      this.keys = keys;
    }
    columns.forEach(({key}, k) => { this.head.rows[0].cells[k].ariaSort = {[key]: 'ascending', [`-${key}`]: 'descending'}[sort] || 'none'; });
  }

  // Numbers: the largest first, then the smallest; texts the other way round; then as they are in the files
  sortBy({key, decimals}) {
    const turns = decimals === null ? [key, `-${key}`, ''] : [`-${key}`, key, ''];
    this.renew({sort: turns[(turns.indexOf(this.state.sort) + 1) % 3]});
  }

  // --- rows

  // Rows in the window and beyond it, px to scroll for these, the first row in the window
  get shown() { return Math.max(1, Math.floor((this.grid.clientHeight - this.head.offsetHeight) / ROW)); }

  get beyond() { return Math.max(0, (this.state.found?.count || 0) - this.shown); }

  get far() { return Math.min(ROW * this.beyond, TALLEST); }

  get first() { return this.far ? Math.min(this.beyond, Math.round(this.grid.scrollTop / this.far * this.beyond)) : 0; }

  row(number = this.state.active) { return this.state.blocks.get(Math.floor(number / BLOCK))?.[number % BLOCK]; }

  cell(key, row = this.row()) { return row?.[this.state.found.columns.findIndex(one => one.key === key)] ?? ''; }

  draw() {
    const {found, active, marked} = this.state;
    if (!found || !this.grid.clientHeight) return;
    this.whole.style.height = `${this.grid.clientHeight + this.far}px`;
    const {first} = this, last = Math.min(found.count, first + this.shown);
    for (let block = Math.floor(first / BLOCK); BLOCK * block < last; block++) this.read(block);
    this.body.replaceChildren(...Array.from({length: Math.max(0, last - first)}, (_, k) => this.line(first + k)));
    Object.assign(this.grid, {ariaRowCount: String(found.count)}).setAttribute('aria-activedescendant', `list-row-${active}`);
    const [count, total] = [found.count, found.total].map(one => one.toLocaleString('en'));
    const words = `${count}${count === total ? '' : ` of ${total}`} rows${marked.size ? `, ${marked.size} marked` : ''}`;
    this.words.textContent = found.total ? words : EMPTY[this.name] || 'none';
    this.showActs();
    this.showSide();
  }

  line(number) {
    const row = this.row(number), {found, active, marked} = this.state;
    const line = make('tr', {id: `list-row-${number}`, className: number === active ? 'active' : '', ariaRowIndex: String(number + 1)});
    line.ariaSelected = String(Boolean(row) && marked.has(this.keyOf(row)));
    if (row && row[0] === this.app.selection) line.ariaCurrent = 'true';
    line.append(...found.columns.map(({key, decimals}, k) => {
      const value = row?.[k] ?? '', places = /^(line|sample)$/.test(key) ? 2 : decimals;
      const textContent = decimals === null || value === '' ? value : value.toFixed(places).replace('-', '−');
      return make('td', {className: decimals === null ? '' : 'number', title: value, textContent});
    }));
    return Object.assign(line, {number});
  }

  keyOf(row) { return this.name === 'measurements' ? `${row[0]}\n${row[1]}` : row[0]; }

  // Make a row the active one, and bring it into sight
  go(number) {
    const {state, first, shown, beyond} = this;
    state.active = Math.max(0, Math.min(number, state.found.count - 1));
    const to = Math.max(Math.min(first, state.active), state.active - shown + 1);
    this.whole.style.height = `${this.grid.clientHeight + this.far}px`;
    if (to !== first) this.grid.scrollTop = to / beyond * this.far;
    this.draw();
  }

  mark(row) {
    if (row && !this.state.marked.delete(this.keyOf(row))) this.state.marked.set(this.keyOf(row), row);
  }

  async markAll() {
    const {state} = this, found = await this.app.orSay(this.app.request(`/api/list?${this.query({first: 0, count: MOST})}`));
    if (state !== this.state) return;
    for (const row of found?.rows || []) state.marked.set(this.keyOf(row), row);
    this.draw();
  }

  // A point is selected for all views; Enter and a double click show an image
  select(whole = false) {
    const row = this.row();
    if (!row) return;
    this.selecting = true;
    if (this.ofPoints) this.app.select(row[0]);
    this.selecting = false;
    if (this.name === 'images' && whole) this.app.look({kind: 'image', name: row[0]}, 'images');
    this.draw();
  }

  click(event) {
    const number = event.target.closest('tr')?.number, {active} = this.state;
    if (number === undefined) return;
    if (event.shiftKey) for (let k = Math.min(number, active); k <= Math.max(number, active); k++) this.mark(this.row(k));
    else if (event.ctrlKey || event.metaKey) this.mark(this.row(number));
    this.go(number);
    this.select();
  }

  key(event) {
    if (event.target !== this.grid || !this.state.found || withModifier(event)) return;
    const {active, found} = this.state, {shown} = this, steps = {ArrowDown: 1, ArrowUp: -1, PageDown: shown, PageUp: -shown, Home: -active, End: found.count};
    const act = event.key === 'u' && !this.app.scene.verdicts ? null : ACTS[event.key]; // u: undo of a project
    if (event.key in steps) this.go(active + steps[event.key]);
    else if (event.key === 'Enter') this.select(true);
    else if (event.key === ' ') { this.mark(this.row()); this.go(active + 1); } else if (act && this.ofPoints) this.act(act[0]);
    else if (event.key === 'n' && !this.note.hidden) this.note.focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  // --- reject and accept, save

  // Why rows can't be rejected or accepted, and what to do; empty where they can
  get refusal() {
    const {kind, verdicts} = this.app.scene, {size} = this.state.marked;
    if (kind !== 'project' && !verdicts) return 'To reject, make a project: mgsgraph project init PROJECT --case CASE. For verdicts, start the studio with --case CASE.';
    if (kind !== 'project' && this.name !== 'points') return 'Verdicts are about points. To reject measurements: mgsgraph project init PROJECT --case CASE.';
    if (kind === 'project' && this.app.refusal) return this.app.refusal;
    return size > MOST ? `At most ${MOST} rows at a time; ${size} are marked.` : '';
  }

  showActs() {
    const {verdicts} = this.app.scene, {found: {count}, marked: {size}} = this.state, hidden = !this.ofPoints, refusal = hidden ? '' : this.refusal;
    for (const one of this.acts) Object.assign(one, {hidden, disabled: Boolean(refusal), title: refusal || (size ? 'The marked rows' : 'The active row')});
    this.only.hidden = this.name === 'profiles';
    this.acts[2].hidden = this.note.hidden = hidden || !verdicts;
    this.note.disabled = Boolean(refusal);
    if (document.activeElement !== this.note) this.note.value = this.cell('note');
    this.reason.textContent = refusal || (verdicts ? `Verdicts: ${verdicts.split(/[\\/]/).pop()}` : '');
    this.reason.title = verdicts || '';
    Object.assign(this.all, {disabled: count > MOST || !count, title: count > MOST ? `More than ${MOST} rows: filter first` : 'Mark the rows that are listed'});
    Object.assign(this.save, {textContent: size ? 'Save marked …' : 'Save table …', title: `The ${size ? 'marked' : 'listed'} rows, as CSV`, disabled: !count});
    this.none.disabled = !size;
  }

  async act(kind, note) {
    const {state} = this, {scene} = this.app, marked = state.marked.size, rows = marked ? [...state.marked.values()] : [this.row()].filter(Boolean);
    if (this.refusal || !rows.length) return this.app.say(this.refusal, 'error');
    this.grid.focus({preventScroll: true});
    this.app.say(`${rows.length} rows: ${kind} …`);
    this.pending += 1;
    try {
      if (scene.kind === 'project') await this.app.change({kind, rows: rows.map(row => [row[0], this.name === 'measurements' ? row[1] : ''])});
      else {
        if (!marked) this.go(state.active + 1); // the next key is about the next row, also before the answer
        await this.app.request('/api/verdicts', {verdict: kind, points: rows.map(row => row[0]), ...(note === undefined ? {} : {note})});
        this.app.say(`${marked ? `${rows.length} points` : rows[0][0]}: ${kind}.`);
      }
      state.marked.clear();
    } catch (error) {
      this.app.say(error.message, 'error');
    }
    this.pending -= 1;
    return this.pending || this.reload(this.name === 'points' ? this.row()?.[0] : '');
  }

  saveMarked() {
    const quoted = value => (/[",\r\n]/.test(value ?? '') ? `"${value.replaceAll('"', '""')}"` : value ?? '');
    const names = this.state.found.columns.map(({key, unit}) => (unit ? `${key}_${unit}` : key)), rows = [names, ...this.state.marked.values()];
    save(new Blob(rows.map(row => `${row.map(quoted).join(',')}\n`), {type: 'text/csv'}), `${this.name}_marked.csv`);
  }

  // --- pixels around the measurements of the active row's point

  showSide() {
    const pictured = new Set(this.app.scene.images.filter(one => one.picture).map(one => one.name));
    const point = pictured.size && this.ofPoints ? this.row()?.[0] ?? '' : '';
    this.side.hidden = !(pictured.size && this.ofPoints);
    if (point === this.point) return;
    this.point = point;
    if (!point) this.side.replaceChildren();
    clearTimeout(this.waiting);
    if (point) this.waiting = setTimeout(() => this.app.orSay(this.chips(point, pictured)), 80);
  }

  async chips(point, pictured) {
    const {columns, rows} = await this.app.request(`/api/list?${new URLSearchParams({table: 'measurements', point: `=${point}`, count: 12})}`);
    if (point !== this.point) return;
    this.side.replaceChildren(make('strong', {textContent: point}), rows.length ? '' : caption('No image measurement.'));
    const chips = new Chips(this.app);
    for (const row of rows) {
      const {image, line, sample, state, residual_line: dl, residual_sample: ds, residual_sigmas: size} = Object.fromEntries(columns.map(({key}, k) => [key, row[k]]));
      const words = `${image}, ${state}${size ? `, residual ${short(size)} sigmas` : ''}`, residual = Number.isFinite(dl) ? [dl, ds] : null;
      const picture = pictured.has(image) && chips.of({image, line, sample, residual_px: residual, used: state === 'used'});
      this.side.append(make('figure', {}, picture || '', make('figcaption', {textContent: words})));
    }
  }
}

export {Lists as Panel};
