-- Wireshark dissector of biobot messages. The tables above this line are made from the wire format's own; nothing here is to be edited.
-- Put the file into Wireshark's folder of personal Lua plugins, or run: wireshark -X lua_script:biobot.lua FILE.pcapng

local bits = bit32 or bit
local SIZES = { B = 1, b = 1, H = 2, I = 4, Q = 8 }

local message = Proto("biobot", "Biobot message")
local line = Proto("biobot_line", "Biobot dongle line")

local field_list, by_name = {}, {}

local function declare(key, code, title, names, unit)
  local abbreviation = "biobot." .. key
  local field
  if code == "B" then field = ProtoField.uint8(abbreviation, title, base.DEC, names)
  elseif code == "b" then field = ProtoField.int8(abbreviation, title, base.DEC, names)
  elseif code == "H" then field = ProtoField.uint16(abbreviation, title, base.DEC, names)
  elseif code == "I" then field = ProtoField.uint32(abbreviation, title, base.DEC, names)
  elseif code == "Q" then field = ProtoField.uint64(abbreviation, title, base.HEX)
  else field = ProtoField.string(abbreviation, title) end
  field_list[#field_list + 1] = field
  by_name[key] = { field = field, unit = unit }
end

local function declare_layout(layout)
  for _, list in ipairs({ layout.fields, layout.entry }) do
    for _, one in ipairs(list) do
      local title = one.name:gsub("_", " ") .. (one.unit ~= "" and " [" .. one.unit .. "]" or "")
      declare(layout.key .. "." .. one.name, one.code, title, one.names, one.unit)
    end
  end
  if layout.text then declare(layout.key .. ".text", "s", "text") end
end

local type_names = {}
for kind, layout in pairs(MESSAGES) do
  type_names[kind] = layout.name
  declare_layout(layout)
end
local envelope_names = {}
for kind, layout in pairs(ENVELOPES) do
  envelope_names[kind] = layout.name
  declare_layout(layout)
end
for _, header in ipairs({ UPLINK_HEADER, DOWNLINK_HEADER, LINK_HEADER }) do
  for _, one in ipairs(header) do
    if by_name[one.name] == nil then
      local names = one.name == "type" and type_names or one.names
      declare(one.name, one.code, one.name:gsub("_", " "), names, one.unit)
    end
  end
end
declare("crc", "H", "CRC-16")
declare("encounter_duration_ms", "I", "duration [ms]")
declare("encounter_is_ongoing", "B", "ongoing", { [0] = "no", [1] = "yes" })
declare("envelope", "B", "envelope", envelope_names)
message.fields = field_list

local body_field = ProtoField.bytes("biobot_line.frame", "Frame on the line")
line.fields = { body_field }
local bad = ProtoExpert.new("biobot.bad", "Not as the wire format has it", expert.group.MALFORMED, expert.severity.WARN)
message.experts = { bad }

local function crc16(range)
  local crc = 0xFFFF
  for at = 0, range:len() - 1 do
    crc = bits.bxor(crc, bits.lshift(range(at, 1):uint(), 8))
    for _ = 1, 8 do
      local shifted = bits.band(bits.lshift(crc, 1), 0xFFFF)
      crc = bits.band(crc, 0x8000) ~= 0 and bits.bxor(shifted, 0x1021) or shifted
    end
  end
  return bits.band(crc, 0xFFFF)
end

-- Adds the fields of a list from `at` on; returns where it ended, and their values by name. It stops where the bytes do.
local function add_fields(list, prefix, tvb, at, limit, tree)
  local values = {}
  for _, one in ipairs(list) do
    local size = SIZES[one.code]
    if at + size > limit then return at, values, at ~= limit end
    local known = by_name[prefix .. one.name]
    local range = tvb(at, size)
    tree:add_le(known.field, range)
    if one.code == "b" then values[one.name] = range:le_int()
    elseif one.code ~= "Q" then values[one.name] = range:le_uint() end
    at = at + size
  end
  return at, values, false
end

local function add_entries(layout, tvb, at, limit, tree)
  local size = 0
  for _, one in ipairs(layout.entry) do size = size + SIZES[one.code] end
  local count = 0
  while at + size <= limit do
    count = count + 1
    local branch = tree:add(message, tvb(at, size), "entry " .. count)
    local _, values = add_fields(layout.entry, layout.key .. ".", tvb, at, at + size, branch)
    if values.duration_high then
      local duration = bits.lshift(bits.band(values.duration_high, 0x3F), 16) + values.duration_low
      local ongoing = values.duration_high >= 0x80 and 1 or 0
      branch:add(by_name["encounter_duration_ms"].field, tvb(at, size), duration):set_generated()
      branch:add(by_name["encounter_is_ongoing"].field, tvb(at, size), ongoing):set_generated()
      branch:append_text(string.format(": with %d for %d ms%s", values.peer, duration, ongoing == 1 and " so far" or ""))
    end
    at = at + size
  end
  return at, count
end

local function add_layout(layout, tvb, at, limit, tree)
  local ended, values, is_cut = add_fields(layout.fields, layout.key .. ".", tvb, at, limit, tree)
  at = ended
  local count
  if #layout.entry > 0 then
    at, count = add_entries(layout, tvb, at, limit, tree)
    is_cut = is_cut or at < limit
  end
  if layout.text and at < limit then tree:add(by_name[layout.key .. ".text"].field, tvb(at, limit - at)) end
  if is_cut then tree:add_proto_expert_info(bad, "its length does not fit") end
  return values, count
end

local function is_message(tvb)
  local size = tvb:len()
  return size >= 6 and size <= MAX_RADIO_PAYLOAD and MESSAGES[tvb(0, 1):uint()] ~= nil and crc16(tvb()) == 0
end

local function dissect_message(tvb, pinfo, tree)
  local layout = MESSAGES[tvb(0, 1):uint()]
  local limit = tvb:len() - 2
  local header = layout.is_uplink and UPLINK_HEADER or DOWNLINK_HEADER
  local branch = tree:add(message, tvb(), "Biobot " .. layout.name)
  local at, heading, is_cut = add_fields(header, "", tvb, 0, limit, branch)
  if is_cut or heading.sequence == nil or (layout.is_uplink and heading.sent_ms == nil) then
    branch:add_proto_expert_info(bad, "it ends in its header")
    return
  end
  local who = heading.node and string.format(" node %d", heading.node) or ""
  local values, count = add_layout(layout, tvb, at, limit, branch)
  branch:add(by_name["crc"].field, tvb(limit, 2))
  local what = count and string.format(" (%d)", count) or ""
  if values.action then
    for _, one in ipairs(layout.fields) do
      if one.name == "action" then what = " " .. (one.names[values.action] or values.action) end
    end
  end
  branch:append_text(string.format("%s #%d%s", who, heading.sequence, what))
  pinfo.cols.protocol = "Biobot"
  pinfo.cols.info = string.format("%s%s #%d%s", layout.name, who, heading.sequence, what)
end

function message.dissector(tvb, pinfo, tree)
  if not is_message(tvb) then
    tree:add(message, tvb(), "Biobot: no message of this version"):add_proto_expert_info(bad, "type or CRC-16")
    return
  end
  dissect_message(tvb, pinfo, tree)
end

message:register_heuristic("wpan", function(tvb, pinfo, tree)
  if tvb:len() < 7 or tvb(0, 1):uint() ~= PREFIX then return false end
  local payload = tvb(1):tvb()
  if not is_message(payload) then return false end
  dissect_message(payload, pinfo, tree)
  return true
end)

-- Undoes consistent overhead byte stuffing; returns the bytes in hexadecimal, or nil.
local function cobs_decode(range)
  local out, at, size = {}, 0, range:len()
  while at < size do
    local code = range(at, 1):uint()
    if code == 0 or at + code > size then return nil end
    for i = 1, code - 1 do
      local byte = range(at + i, 1):uint()
      if byte == 0 then return nil end
      out[#out + 1] = string.format("%02x", byte)
    end
    at = at + code
    if code < 255 and at < size then out[#out + 1] = "00" end
  end
  return table.concat(out)
end

local function dissect_native(tvb, pinfo, tree)
  local from, to = 0, tvb:len()
  while from < to and tvb(from, 1):uint() == 0 do from = from + 1 end
  while to > from and tvb(to - 1, 1):uint() == 0 do to = to - 1 end
  local decoded = to > from and cobs_decode(tvb(from, to - from)) or nil
  if decoded == nil or #decoded < 12 then return end
  local frame = ByteArray.new(decoded):tvb("Native frame")
  if crc16(frame()) ~= 0 then return end
  local limit = frame:len() - 2
  local branch = tree:add(message, frame(), "Biobot link")
  local at, heading = add_fields(LINK_HEADER, "", frame, 0, limit, branch)
  branch:add(by_name["crc"].field, frame(limit, 2))
  local name = LINK_KINDS[heading.kind] or ("kind " .. (heading.kind or "?"))
  branch:append_text(string.format(" %s session %d #%d", name, heading.session or 0, heading.link_sequence or 0))
  pinfo.cols.info = string.format("%s session %d #%d", name, heading.session or 0, heading.link_sequence or 0)
  if name ~= "DATA" or at >= limit then return end
  local kind = frame(at, 1):uint()
  local layout = ENVELOPES[kind]
  local inner = tree:add(message, frame(at, limit - at), "Biobot envelope " .. (layout and layout.name or "unknown"))
  inner:add(by_name["envelope"].field, frame(at, 1))
  if layout == nil then return end
  pinfo.cols.info:append(" " .. layout.name)
  if not layout.carries_payload then
    add_layout(layout, frame, at + 1, limit, inner)
    return
  end
  at = add_fields(layout.fields, layout.key .. ".", frame, at + 1, limit, inner)
  if at < limit then message.dissector(frame(at, limit - at):tvb(), pinfo, tree) end
end

function line.dissector(tvb, pinfo, tree)
  pinfo.cols.protocol = "Biobot line"
  local branch = tree:add(line, tvb(), "Biobot dongle line")
  branch:add(body_field, tvb())
  local first = tvb(0, 1):uint()
  if first == 0x7E then pinfo.cols.info = "XBee API frame"
  elseif first == 0xFE then pinfo.cols.info = "Z-Stack MT frame"
  else
    pinfo.cols.info = "no native frame"
    dissect_native(tvb, pinfo, tree)
  end
end

DissectorTable.get("wtap_encap"):add(wtap.USER0, line)
