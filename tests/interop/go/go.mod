module main_device

go 1.19
