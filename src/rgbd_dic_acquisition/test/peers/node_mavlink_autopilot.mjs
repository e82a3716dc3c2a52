// An autopilot on node-mavlink, a third implementation of MAVLink, in TypeScript: the same attitude over UDP.
//   node node_mavlink_autopilot.mjs PORT
// Its time since boot begins at 100 s; attitude and time are sent 30 ms late, TIMESYNC is answered at once.
import { createSocket } from 'node:dgram'
import { PassThrough } from 'node:stream'
import { MavLinkPacketParser, MavLinkPacketSplitter, MavLinkProtocolV2, common, minimal } from 'node-mavlink'

const [ROLL, PITCH, YAW_RATE, EPOCH_S] = [0.1, -0.2, 0.5, 1_700_000_000]
const DELAY_MS = 30
const port = Number(process.argv[2])
const protocol = new MavLinkProtocolV2(1, 1)
const socket = createSocket('udp4')
const startNs = hostNs()
let sequence = 0

function hostNs () {
  return BigInt(Math.round((performance.timeOrigin + performance.now()) * 1000)) * 1000n
}

function bootNs (ns) {
  return 100_000_000_000n + ns - startNs
}

function send (message) {
  socket.send(protocol.serialize(message, sequence++ % 256), port, '127.0.0.1')
}

function attitude () {
  const now = hostNs()
  const message = new common.Attitude()
  const yaw = YAW_RATE * (Number((now - BigInt(EPOCH_S) * 1_000_000_000n) % 1_000_000_000_000n) / 1e9)
  message.timeBootMs = Number(bootNs(now) / 1_000_000n)
  message.roll = ROLL
  message.pitch = PITCH
  message.yaw = Math.atan2(Math.sin(yaw), Math.cos(yaw))
  message.rollspeed = -Math.sin(PITCH) * YAW_RATE
  message.pitchspeed = Math.sin(ROLL) * Math.cos(PITCH) * YAW_RATE
  message.yawspeed = Math.cos(ROLL) * Math.cos(PITCH) * YAW_RATE
  setTimeout(() => send(message), DELAY_MS)
}

function everySecond () {
  const heartbeat = new minimal.Heartbeat()
  heartbeat.type = minimal.MavType.QUADROTOR
  heartbeat.autopilot = minimal.MavAutopilot.PX4
  heartbeat.systemStatus = minimal.MavState.ACTIVE
  send(heartbeat)
  const now = hostNs()
  const time = new common.SystemTime()
  time.timeUnixUsec = now / 1000n
  time.timeBootMs = Number(bootNs(now) / 1_000_000n)
  setTimeout(() => send(time), DELAY_MS)
}

const received = new PassThrough()
received.pipe(new MavLinkPacketSplitter()).pipe(new MavLinkPacketParser()).on('data', packet => {
  if (packet.header.msgid !== common.TimeSync.MSG_ID) return
  const request = packet.protocol.data(packet.payload, common.TimeSync)
  if (request.tc1 !== 0n) return
  const reply = new common.TimeSync()
  reply.tc1 = bootNs(hostNs())
  reply.ts1 = request.ts1
  send(reply)
})
socket.on('message', data => received.write(data))
setInterval(attitude, 20)
setInterval(everySecond, 1000)
everySecond()
console.log('flying')
