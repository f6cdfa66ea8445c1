// A MainDevice in Go, of the standard library alone: a packet socket by raw system calls, a goroutine that receives, timers of the
// runtime. It brings devices without a mailbox into OP, sets up their clocks and SYNC0, and exchanges process data in step with the
// reference clock.
//
//	main_device INTERFACE [CYCLES]
package main

import (
	"encoding/binary"
	"errors"
	"fmt"
	"net"
	"os"
	"strconv"
	"syscall"
	"time"
)

const (
	cycle     = 4 * time.Millisecond
	shift     = 2 * time.Millisecond
	protocol  = 0xA488 // EtherType 88A4, as a packet socket wants it on a little-endian machine
	patience  = 20 * time.Millisecond
	inputBase = 0x1000 // logical address of all inputs; outputs begin at 0
)

// Commands of datagrams.
const (
	aprd = 1 + iota
	apwr
	_
	fprd
	fpwr
	_
	brd
	bwr
	_
	_
	_
	lrw
	_
	frmw
)

type datagram struct {
	command byte
	address uint32 // of a device in the lower half and of a register in the upper one, or logical
	data    []byte
	counter uint16
}

type segment struct {
	socket  int
	index   byte
	answers chan []byte
	devices int
}

func open(name string) (*segment, error) {
	socket, err := syscall.Socket(syscall.AF_PACKET, syscall.SOCK_RAW, protocol)
	if err != nil {
		return nil, fmt.Errorf("socket: %w", err)
	}
	found, err := net.InterfaceByName(name)
	if err != nil {
		return nil, err
	}
	if err := syscall.Bind(socket, &syscall.SockaddrLinklayer{Protocol: protocol, Ifindex: found.Index}); err != nil {
		return nil, fmt.Errorf("bind: %w", err)
	}
	s := &segment{socket: socket, answers: make(chan []byte, 16)}
	go s.receive()
	return s, nil
}

func (s *segment) receive() {
	for {
		buffer := make([]byte, 1514)
		n, _, err := syscall.Recvfrom(s.socket, buffer, 0)
		if err == nil && n > 16 {
			s.answers <- buffer[:n]
		}
	}
}

// exchange sends datagrams in one frame, and takes their data and working counters from its answer.
func (s *segment) exchange(datagrams ...*datagram) error {
	frame := []byte{255, 255, 255, 255, 255, 255, 2, 0, 0, 0, 0, 1, 0x88, 0xA4, 0, 0}
	s.index++
	for at, d := range datagrams {
		length := uint16(len(d.data))
		if at+1 < len(datagrams) {
			length |= 0x8000
		}
		frame = append(frame, d.command, s.index)
		frame = binary.LittleEndian.AppendUint32(frame, d.address)
		frame = binary.LittleEndian.AppendUint16(frame, length)
		frame = append(frame, 0, 0)
		frame = append(append(frame, d.data...), 0, 0)
	}
	binary.LittleEndian.PutUint16(frame[14:], uint16(len(frame)-16)|0x1000)
	for len(frame) < 60 {
		frame = append(frame, 0)
	}
	if _, err := syscall.Write(s.socket, frame); err != nil {
		return fmt.Errorf("send: %w", err)
	}
	late := time.After(patience)
	for {
		select {
		case answer := <-s.answers:
			if len(answer) < len(frame) || answer[17] != s.index {
				continue
			}
			at := 16
			for _, d := range datagrams {
				copy(d.data, answer[at+10:])
				d.counter = binary.LittleEndian.Uint16(answer[at+10+len(d.data):])
				at += 12 + len(d.data)
			}
			return nil
		case <-late:
			return errors.New("no answer")
		}
	}
}

func register(device uint16, at uint16) uint32 { return uint32(device) | uint32(at)<<16 }

func station(position int) uint16 { return uint16(0x1001 + position) }

func (s *segment) read(position int, at uint16, bytes int) uint64 {
	d := &datagram{command: fprd, address: register(station(position), at), data: make([]byte, bytes)}
	s.must(d, 1)
	var whole [8]byte
	copy(whole[:], d.data)
	return binary.LittleEndian.Uint64(whole[:])
}

func (s *segment) write(position int, at uint16, value uint64, bytes int) {
	data := binary.LittleEndian.AppendUint64(nil, value)[:bytes]
	s.must(&datagram{command: fpwr, address: register(station(position), at), data: data}, 1)
}

func (s *segment) must(d *datagram, counter int) {
	if err := s.exchange(d); err != nil {
		fail("command %d of 0x%04X: %v", d.command, d.address>>16, err)
	}
	if int(d.counter) != counter {
		fail("command %d of 0x%04X: working counter %d, expected %d", d.command, d.address>>16, d.counter, counter)
	}
}

func fail(format string, what ...any) {
	fmt.Printf(format+"\n", what...)
	os.Exit(1)
}

func (s *segment) all(at uint16, data []byte) {
	s.must(&datagram{command: bwr, address: register(0, at), data: data}, s.devices)
}

// eeprom reads two words.
func (s *segment) eeprom(position int, word uint16) uint32 {
	s.write(position, 0x0504, uint64(word), 4)
	s.write(position, 0x0502, 0x0100, 2)
	for s.read(position, 0x0502, 2)&0x8000 != 0 {
	}
	return uint32(s.read(position, 0x0508, 4))
}

// setUp programs the SyncManagers of process data as the EEPROM has them, and an FMMU for each.
func (s *segment) setUp(position int, size uint32) {
	word := uint16(0x40)
	for {
		head := s.eeprom(position, word)
		kind, words := uint16(head), uint16(head>>16)
		if kind == 0xFFFF {
			return
		}
		if kind == 41 {
			for manager := uint16(0); manager < words/4; manager++ {
				first, second := s.eeprom(position, word+2+4*manager), s.eeprom(position, word+4+4*manager)
				s.manage(position, manager, first, second, size)
			}
		}
		word += 2 + words
	}
}

func (s *segment) manage(position int, manager uint16, place, about, size uint32) {
	start, length, control := place&0xFFFF, place>>16, about&0xFF
	kind := about >> 24
	if kind != 3 && kind != 4 {
		return
	}
	s.write(position, 0x0800+8*manager, uint64(place)|uint64(control)<<32|1<<48, 8)
	logical, direction := uint32(position)*size, uint64(2)
	if kind == 4 {
		logical, direction = logical+inputBase, 1
	}
	// Logical start, length, bits 0 to 7; physical start, bit 0, direction, active.
	unit := 0x0600 + 16*manager
	s.write(position, unit, uint64(logical)|uint64(length)<<32|7<<56, 8)
	s.write(position, unit+8, uint64(start)|direction<<24|1<<32, 8)
}

func (s *segment) ask(state byte) {
	s.all(0x0120, []byte{state, 0})
	for begun := time.Now(); time.Since(begun) < time.Second; time.Sleep(time.Millisecond) {
		d := &datagram{command: brd, address: register(0, 0x0130), data: make([]byte, 2)}
		s.must(d, s.devices)
		if d.data[0] == state {
			return
		}
	}
	fail("state %d: not all devices are there", state)
}

// clocks measures delays along a line, and sets offsets and delays.
func (s *segment) clocks() {
	s.all(0x0900, []byte{0, 0, 0, 0})
	var passage []int64
	reference := s.read(0, 0x0918, 8)
	for position := 0; position < s.devices; position++ {
		times := s.read(position, 0x0900, 8)
		behind := int64(0)
		if position+1 < s.devices {
			behind = int64(uint32(times>>32) - uint32(times))
		}
		passage = append(passage, behind)
	}
	for position := 0; position < s.devices; position++ {
		local := s.read(position, 0x0918, 8)
		s.write(position, 0x0920, reference-local, 8)
		s.write(position, 0x0928, uint64((passage[0]-passage[position])/2), 4)
		s.write(position, 0x0934, 4, 1)
		s.write(position, 0x0935, 6, 1)
	}
	// Offsets go at once, speeds take their time: they are learned from frame to frame.
	for number := 0; number < 3_000; number++ {
		sleep(time.Millisecond)
		s.must(&datagram{command: frmw, address: register(station(0), 0x0910), data: make([]byte, 8)}, s.devices)
	}
}

// sleep has no runtime timer behind it: those wake up by whole milliseconds.
func sleep(span time.Duration) {
	if span > 0 {
		rest := syscall.NsecToTimespec(int64(span))
		for syscall.Nanosleep(&rest, &rest) == syscall.EINTR {
		}
	}
}

func (s *segment) sync() {
	now := s.read(0, 0x0910, 8)
	whole := uint64(cycle)
	start := (now+uint64(100*time.Millisecond))/whole*whole + uint64(shift)
	for position := 0; position < s.devices; position++ {
		s.write(position, 0x0981, 0, 1)
		s.write(position, 0x0990, start, 8)
		s.write(position, 0x09A0, whole, 4)
		s.write(position, 0x0981, 3, 1)
	}
	sleep(150 * time.Millisecond)
	for position := 0; position < s.devices; position++ {
		next := s.read(position, 0x0990, 8)
		sleep(2 * cycle)
		if s.read(position, 0x0990, 8) == next {
			fail("device %d: no pulse of SYNC0 in two cycles", position)
		}
	}
}

func main() {
	if len(os.Args) < 2 {
		fail("main_device INTERFACE [CYCLES]")
	}
	cycles := 10_000
	if len(os.Args) > 2 {
		cycles, _ = strconv.Atoi(os.Args[2])
	}
	s, err := open(os.Args[1])
	if err != nil {
		fail("%v", err)
	}
	count := &datagram{command: brd, data: make([]byte, 1)}
	if err := s.exchange(count); err != nil || count.counter == 0 {
		fail("no SubDevice: %v", err)
	}
	s.devices = int(count.counter)
	s.ask(1)
	const size = 16
	for position := 0; position < s.devices; position++ {
		data := binary.LittleEndian.AppendUint16(nil, station(position))
		s.must(&datagram{command: apwr, address: register(uint16(-position), 0x0010), data: data}, 1)
		s.setUp(position, size)
	}
	s.ask(2)
	s.clocks()
	s.sync()

	lengths := s.devices * size
	outputs := &datagram{command: lrw, address: 0, data: make([]byte, lengths)}
	inputs := &datagram{command: lrw, address: inputBase, data: make([]byte, lengths)}
	drift := &datagram{command: frmw, address: register(station(0), 0x0910), data: make([]byte, 8)}
	due, incomplete, wrong := time.Now(), 0, 0
	for number := 0; number < cycles; number++ {
		sleep(time.Until(due))
		for at := range outputs.data {
			outputs.data[at] = byte(number)
		}
		if s.exchange(drift, outputs, inputs) != nil || int(outputs.counter) != 2*s.devices || int(inputs.counter) != s.devices {
			incomplete++
		}
		// The reference's time says how far this frame was off the beginning of a cycle.
		off := (time.Duration(binary.LittleEndian.Uint64(drift.data))+cycle/2)%cycle - cycle/2
		due = due.Add(cycle - off/16)
		switch {
		case number == 200:
			s.ask(4)
		case number == 400:
			s.ask(8)
		case number > 500 && inputs.data[0] != byte(number-1):
			wrong++
		}
	}
	differences := []uint64{}
	for position := 0; position < s.devices; position++ {
		if state := s.read(position, 0x0130, 2); state != 8 {
			fail("device %d is in state 0x%X, AL status code 0x%04X", position, state, s.read(position, 0x0134, 2))
		}
		differences = append(differences, s.read(position, 0x092C, 4)&0x7FFFFFFF)
	}
	fmt.Printf("%d devices, %d cycles, %d incomplete, %d with other inputs than sent, 0x092C %v ns\n", s.devices, cycles, incomplete, wrong, differences)
	s.ask(1)
}
