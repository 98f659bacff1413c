# placeholder until the packaging is written
