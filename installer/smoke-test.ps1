<#
.SYNOPSIS
Installs the built installer on this Windows, tries the program, upgrades and uninstalls it.

.DESCRIPTION
Needs an administrator's 64-bit PowerShell (5.1 or 7) and a PC that does not have the
program. No sensor is needed: all virtual ones are run. Settings and logs of the tries are in
a temporary folder; the user's own settings must outlive upgrade and removal, and are as
before at the end.

Ends with exit code 1 and one sentence at the first thing that is not as it must be; the
program may then still be installed.

.PARAMETER Setup
The installer. Without it the only one in dist.

.EXAMPLE
powershell -ExecutionPolicy Bypass -File installer\smoke-test.ps1
#>
[CmdletBinding()]
param([string] $Setup = '')

Set-StrictMode -Version 3.0
$ErrorActionPreference = 'Stop'
# Exit codes are checked below, with a sentence that says what failed.
$PSNativeCommandUseErrorActionPreference = $false

$Program = 'biosensor-gateway'
$Name = 'Biosensor Gateway'
$Exe = "$Program.exe"
$Folder = Join-Path $env:ProgramFiles $Name
$Bin = Join-Path $Folder 'bin'
$Gateway = Join-Path $Bin $Exe
$Menu = Join-Path ([Environment]::GetFolderPath('CommonPrograms')) $Name
$UserSettings = Join-Path $env:LOCALAPPDATA "$Program\settings.toml"
$UninstallKey = "HKLM:\SOFTWARE\Microsoft\Windows\CurrentVersion\Uninstall\$Program"
$AppPathKey = "HKLM:\SOFTWARE\Microsoft\Windows\CurrentVersion\App Paths\$Exe"
$Shortcuts = @("$Name.lnk", 'Run in a console.lnk', 'Check this PC.lnk', 'Settings.lnk', 'Documentation.lnk', 'Uninstall.lnk')
$Variables = @('BIOSENSOR_GATEWAY_SETTINGS', 'BIOSENSOR_GATEWAY_STATE', 'BIOSENSOR_GATEWAY_LSL__SESSION_ID')
$StreamingSeconds = 20
$RecordingSeconds = 20

function Assert-That {
    param([bool] $Condition, [string] $Sentence)
    if (-not $Condition) {
        throw $Sentence
    }
}

function Wait-Until {
    # Try a condition again and again; fail with a sentence if it does not come true in time.
    param([scriptblock] $Condition, [double] $Seconds, [string] $Sentence)
    $watch = [Diagnostics.Stopwatch]::StartNew()
    while (-not (& $Condition)) {
        Assert-That ($watch.Elapsed.TotalSeconds -lt $Seconds) $Sentence
        Start-Sleep -Milliseconds 500
    }
}

function Invoke-Silently {
    # Run an installer or uninstaller to its end.
    param([string] $File, [string] $Options)
    $process = Start-Process -FilePath $File -ArgumentList $Options -Wait -PassThru
    Assert-That ($process.ExitCode -eq 0) "'$File $Options' ended with exit code $($process.ExitCode)."
}

function Invoke-Gateway {
    # Run a command of the installed program and return what it prints.
    param([string[]] $Arguments)
    $output = & $Gateway @Arguments
    Assert-That ($LASTEXITCODE -eq 0) "'$Exe $($Arguments -join ' ')' ended with exit code $LASTEXITCODE."
    return ($output -join "`n").Trim()
}

function Get-Value {
    # A value of the registry; '' is the key's own. $null if it is not there.
    param([string] $Key, [string] $Value)
    if (-not (Test-Path -LiteralPath $Key)) {
        return $null
    }
    return (Get-Item -LiteralPath $Key).GetValue($Value)
}

function Test-OnPath {
    # Whether terminals of all users find the program.
    $folders = [Environment]::GetEnvironmentVariable('Path', 'Machine') -split ';'
    return @($folders | Where-Object { $_.TrimEnd('\') -eq $Bin }).Count -eq 1
}

function Assert-Ready {
    $identity = [Security.Principal.WindowsPrincipal] [Security.Principal.WindowsIdentity]::GetCurrent()
    $role = [Security.Principal.WindowsBuiltInRole]::Administrator
    Assert-That ($identity.IsInRole($role)) 'This test installs for all users: start PowerShell as administrator.'
    Assert-That ([Environment]::Is64BitProcess) 'A 32-bit PowerShell sees another registry: start the 64-bit one.'
    $set = @($Variables | Where-Object { Test-Path -LiteralPath "Env:$_" })
    Assert-That ($set.Count -eq 0) "The test sets variables of its own: start a PowerShell without $($set -join ', ')."
    $there = (Test-Path -LiteralPath $UninstallKey) -or (Test-Path -LiteralPath $Folder)
    Assert-That (-not $there) "$Name is on this PC already: uninstall it first; the test would remove it."
}

function Find-Setup {
    if ($Setup) {
        Assert-That (Test-Path -LiteralPath $Setup -PathType Leaf) "There is no installer at $Setup."
        return (Resolve-Path -LiteralPath $Setup).ProviderPath
    }
    $dist = Join-Path (Split-Path -Parent $PSScriptRoot) 'dist'
    $found = @(Get-ChildItem -Path (Join-Path $dist "$Program-*-setup.exe"))
    Assert-That ($found.Count -eq 1) "There must be one installer in ${dist}: run installer\build.ps1, or name it with -Setup."
    return $found[0].FullName
}

function Get-SetupVersion {
    param([string] $File)
    $matched = (Split-Path -Leaf $File) -match "^$Program-(.+)-setup\.exe$"
    Assert-That $matched "The version of $File is not in its name: it must be called $Program-VERSION-setup.exe."
    return $Matches[1]
}

function Assert-Checksum {
    param([string] $File)
    $written = ([IO.File]::ReadAllText("$File.sha256") -split '\s+')[0]
    $digest = (Get-FileHash -Algorithm SHA256 -LiteralPath $File).Hash
    Assert-That ($written -eq $digest) "$File does not have the SHA-256 that is written beside it."
}

function Assert-Files {
    foreach ($file in "bin\$Exe", "bin\$Name.exe", 'bin\_internal', 'docs\index.html', 'licenses', 'sbom.cdx.json', 'uninstall.exe') {
        Assert-That (Test-Path -LiteralPath (Join-Path $Folder $file)) "$file is missing in $Folder."
    }
    $commands = @(Get-ChildItem -LiteralPath $Bin -File)
    # The other one has a space in its name, and opens the page.
    Assert-That ($commands.Count -eq 2) "The folder of PATH has $($commands.Count) files instead of the two programs."
    $libraries = @(Get-ChildItem -LiteralPath $Folder -Recurse -Filter 'lsl.dll')
    Assert-That ($libraries.Count -gt 0) "There is no lsl.dll in $Folder."
}

function Assert-Registry {
    param([string] $Version)
    $expected = @{
        DisplayName          = $Name
        DisplayVersion       = $Version
        InstallLocation      = $Folder
        QuietUninstallString = """$(Join-Path $Folder 'uninstall.exe')"" /S _?=$Folder"
    }
    foreach ($value in $expected.Keys) {
        $written = Get-Value $UninstallKey $value
        Assert-That ($written -eq $expected[$value]) "$value of the uninstall key is '$written' instead of '$($expected[$value])'."
    }
    Assert-That ((Get-Value $UninstallKey 'EstimatedSize') -gt 10000) 'EstimatedSize of the uninstall key is under 10 MB.'
    $found = Get-Value $AppPathKey ''
    Assert-That ($found -eq $Gateway) "The App Paths key has '$found' instead of '$Gateway'."
    Assert-That (Test-OnPath) "$Bin is not on the PATH of all users."
}

function Assert-Menu {
    $shell = New-Object -ComObject WScript.Shell
    foreach ($shortcut in $Shortcuts) {
        $file = Join-Path $Menu $shortcut
        Assert-That (Test-Path -LiteralPath $file) "The Start menu lacks '$shortcut'."
        $target = $shell.CreateShortcut($file).TargetPath
        Assert-That (Test-Path -LiteralPath $target -PathType Leaf) "The shortcut '$shortcut' leads to '$target', which does not exist."
    }
}

function Assert-FirewallRules {
    param([int] $Count)
    $rules = @(Get-NetFirewallRule -DisplayName $Name -ErrorAction SilentlyContinue)
    Assert-That ($rules.Count -eq $Count) "There are $($rules.Count) firewall rules '$Name' instead of $Count."
}

function Assert-Installed {
    param([string] $Version)
    Assert-Files
    Assert-Registry $Version
    Assert-Menu
    Assert-FirewallRules 1
    $said = Invoke-Gateway '--version'
    Assert-That ($said -eq "$Program $Version") "--version says '$said' instead of '$Program $Version'."
}

function Get-SampleCounts {
    # Samples that each sensor has sent so far; empty while no agent answers.
    # In Windows PowerShell 5.1 any line on stderr would end the script.
    $ErrorActionPreference = 'Continue'
    $output = & $Gateway status --json 2>$null
    $counts = @{}
    if ($LASTEXITCODE -eq 0) {
        foreach ($device in (($output -join "`n") | ConvertFrom-Json).devices) {
            $pushed = 0
            foreach ($stream in $device.streams.PSObject.Properties) {
                $pushed += $stream.Value.pushed
            }
            $counts[$device.sensor] = $pushed
        }
    }
    return $counts
}

function Get-Silent {
    # Those of the sensors that have sent nothing more than was counted before.
    param([string[]] $Sensors, [hashtable] $Before)
    $now = Get-SampleCounts
    return @($Sensors | Where-Object { -not $now.ContainsKey($_) -or $now[$_] -le $Before[$_] })
}

function Test-Settings {
    # Write and check a settings file; return the sensors that it offers.
    Invoke-Gateway 'config', 'init' | Out-Host
    Invoke-Gateway 'config', 'check' | Out-Host
    $known = Select-String -LiteralPath $env:BIOSENSOR_GATEWAY_SETTINGS -Pattern '^#sensor = "(\w+)"'
    $sensors = @($known | ForEach-Object { $_.Matches[0].Groups[1].Value })
    Assert-That ($sensors.Count -gt 0) 'The settings file that config init wrote has no sensor in it.'
    return $sensors
}

function Test-Recording {
    # What all virtual sensors send for a while must be in a file that is judged green, and by
    # LabRecorder's own program, not by the one that takes its place where that fails.
    param([string] $Folder)
    Invoke-Gateway 'wait-ready', '--timeout', '120' | Out-Host
    $started = Invoke-Gateway 'record', 'start', '--here', '--folder', $Folder, '--participant', 'smoke', '--json' | ConvertFrom-Json
    $instead = @($started.warnings | Where-Object { $_ -match 'records instead' })
    Assert-That ($instead.Count -eq 0) "LabRecorder's program did not record: $($instead -join '; ')"
    Start-Sleep -Seconds $RecordingSeconds
    $stopped = Invoke-Gateway 'record', 'stop', '--json' | ConvertFrom-Json
    $verdict = $stopped.verdict
    $findings = @($verdict.findings | Where-Object { $_.level -ne 'note' } | ForEach-Object { "$($_.stream): $($_.text)" })
    Assert-That ($verdict.colour -eq 'green') "The recording is $($verdict.colour), not green: $($findings -join '; ')"
}

function Test-Streaming {
    # All virtual sensors must stream, go on streaming, and end when they are told to. Returns
    # which they are: not every sensor that is offered has one.
    param([string[]] $Offered, [string] $Logs)
    $redirected = @{
        RedirectStandardOutput = Join-Path $Logs 'run.out'
        RedirectStandardError  = Join-Path $Logs 'run.err'
    }
    $agent = Start-Process $Gateway 'run --simulate all' -PassThru -NoNewWindow @redirected
    # Without this, .NET forgets the exit code.
    $null = $agent.Handle
    try {
        Wait-Until { (Get-SampleCounts).Count -gt 0 } 60 'After 60 s the agent has not said what it streams.'
        $none = Get-SampleCounts
        $sensors = @($none.Keys)
        $unknown = @($sensors | Where-Object { $Offered -notcontains $_ })
        Assert-That ($unknown.Count -eq 0) "The settings file that config init wrote lacks $($unknown -join ', ')."
        $sensors | ForEach-Object { $none[$_] = 0 }
        Wait-Until { @(Get-Silent $sensors $none).Count -eq 0 } 90 'After 90 s some virtual sensor has not sent a sample.'
        $before = Get-SampleCounts
        Start-Sleep -Seconds $StreamingSeconds
        $silent = @(Get-Silent $sensors $before)
        Assert-That ($silent.Count -eq 0) "Within $StreamingSeconds s no sample came from: $($silent -join ', ')."
        Test-Recording (Join-Path $Logs 'recordings')
        Invoke-Gateway 'stop' | Out-Host
        Assert-That ($agent.WaitForExit(30000)) 'The agent runs on 30 s after stop.'
        Assert-That ($agent.ExitCode -eq 0) "The agent that was stopped ended with exit code $($agent.ExitCode)."
        return $sensors
    }
    catch {
        Get-Content -LiteralPath @($redirected.Values) -ErrorAction SilentlyContinue | Out-Host
        throw
    }
    finally {
        if (-not $agent.HasExited) {
            Stop-Process -Id $agent.Id -Force
        }
    }
}

function Test-Program {
    # Settings and streaming, away from the user's own files and other people's streams.
    $temporary = Join-Path ([IO.Path]::GetTempPath()) "$Program-$([guid]::NewGuid())"
    New-Item -ItemType Directory -Path $temporary | Out-Null
    $env:BIOSENSOR_GATEWAY_SETTINGS = Join-Path $temporary 'settings.toml'
    $env:BIOSENSOR_GATEWAY_STATE = $temporary
    $env:BIOSENSOR_GATEWAY_LSL__SESSION_ID = "smoke-test-$PID"
    try {
        $offered = Test-Settings
        Write-Host 'ok: config init and config check'
        $sensors = Test-Streaming $offered $temporary
        Write-Host "ok: samples of $($sensors -join ', '), a green recording of them, and stop"
    }
    finally {
        $Variables | ForEach-Object { Remove-Item -LiteralPath "Env:$_" }
        Remove-Item -LiteralPath $temporary -Recurse -Force -ErrorAction SilentlyContinue
    }
}

function Test-Upgrade {
    # The same version over itself: what the new one does not bring must be gone.
    param([string] $File, [string] $Version)
    $stale = Join-Path $Folder 'bin\_internal\of_an_earlier_version.txt'
    [IO.File]::WriteAllText($stale, 'stale')
    Invoke-Silently $File '/S'
    Assert-That (-not (Test-Path -LiteralPath $stale)) "$stale is still there after an upgrade."
    Assert-Installed $Version
}

function Test-Removal {
    $command = Get-Value $UninstallKey 'QuietUninstallString'
    $quoted = $command -match '^"([^"]+)"\s+(.+)$'
    Assert-That $quoted "QuietUninstallString '$command' is no quoted path with options."
    Invoke-Silently $Matches[1] $Matches[2]
    # It works on as a copy of itself, so that it can remove itself.
    Wait-Until { -not (Test-Path -LiteralPath $Folder) } 60 "$Folder is still there 60 s after the removal."
    foreach ($left in $UninstallKey, $AppPathKey, "HKLM:\SOFTWARE\$Program", $Menu) {
        Assert-That (-not (Test-Path -LiteralPath $left)) "$left is left after the removal."
    }
    Assert-That (-not (Test-OnPath)) "$Bin is left on the PATH of all users after the removal."
    Assert-FirewallRules 0
}

function Test-Replacement {
    # Upgrade, then remove; neither may touch the user's settings.
    param([string] $File, [string] $Version)
    $digest = (Get-FileHash -LiteralPath $UserSettings).Hash
    Test-Upgrade $File $Version
    Assert-That ((Get-FileHash -LiteralPath $UserSettings).Hash -eq $digest) "The upgrade has changed $UserSettings."
    Write-Host 'ok: upgraded over itself'
    Test-Removal
    Assert-That (Test-Path -LiteralPath $UserSettings) "The removal has taken $UserSettings along."
    Assert-That ((Get-FileHash -LiteralPath $UserSettings).Hash -eq $digest) "The removal has changed $UserSettings."
    Write-Host 'ok: removed; only settings are left'
}

function Invoke-SmokeTest {
    Assert-Ready
    $file = Find-Setup
    $version = Get-SetupVersion $file
    Assert-Checksum $file
    # Without being asked it makes no rule; with one its removal is seen, too.
    Invoke-Silently $file '/S /FIREWALL=1'
    Assert-Installed $version
    Write-Host "ok: $Name $version is installed"
    Test-Program

    $made = -not (Test-Path -LiteralPath $UserSettings)
    if ($made) {
        Invoke-Gateway 'config', 'init' | Out-Host
    }
    try {
        Test-Replacement $file $version
    }
    finally {
        if ($made) {
            Remove-Item -LiteralPath $UserSettings -ErrorAction SilentlyContinue
        }
    }
}

try {
    Invoke-SmokeTest
}
catch {
    [Console]::Error.WriteLine("smoke-test.ps1: $($_.Exception.Message)")
    exit 1
}
exit 0
